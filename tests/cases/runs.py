"""What the whole-run tests share: a folder, the meshes, and the program under mpirun."""
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

import h5py

SOURCE = pathlib.Path(__file__).resolve().parents[2]

# A small virtual test; its meshes are plate_with_hole's.
SMALL_PLATE = """
title: Small plate with a hole
specimen: {{mesh: {mesh}.msh, thickness: 4, layers: {layers}, mid_plane_symmetry: true, held: bottom, loaded: top}}
cameras:
  - {{name: front, pixel_size: 0.08, place: {place}{images}}}
material:
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {{E: {E}, nu: 0.25, S_y: {S_y}, H: 1480, delta: 0.042}}
"""
SMALL_TEST = """
simulate:
  centred: true
  value: [0, 0.008, 0.016, 0.024, 0.05, 0.1, 0.2]
virtual: {size: [300, 330], load_noise: 5, static_frames: 2, directory: made}
output: made
"""


def gmsh(script, output, **sizes):
    """Makes a mesh with a script of tools/meshes."""
    command = ["gmsh", "-2", "-v", "2", "-format", "msh41", str(SOURCE / "tools/meshes" / f"{script}.geo"), "-o", str(output)]
    for name, value in sizes.items():
        command[1:1] = ["-setnumber", name, str(value)]
    subprocess.run(command, check=True)


def bar(path, low, high, rows, columns=16, half_width=4.0):
    """Quadrilaterals of a straight bar along y, Gmsh 2.2."""
    nodes = [(half_width * (2 * i / columns - 1), low + (high - low) * j / rows) for j in range(rows + 1) for i in range(columns + 1)]
    number = lambda i, j: j * (columns + 1) + i + 1
    elements = [f"1 2 {tag} {tag} {number(i, j)} {number(i + 1, j)}" for tag, j in ((1, 0), (2, rows)) for i in range(columns)]
    elements += [f"3 2 3 3 {number(i, j)} {number(i + 1, j)} {number(i + 1, j + 1)} {number(i, j + 1)}" for j in range(rows) for i in range(columns)]
    path.write_text('$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n1 1 "bottom"\n1 2 "top"\n2 3 "specimen"\n$EndPhysicalNames\n'
                    f"$Nodes\n{len(nodes)}\n" + "".join(f"{k} {x} {y} 0\n" for k, (x, y) in enumerate(nodes, 1)) + "$EndNodes\n"
                    f"$Elements\n{len(elements)}\n" + "".join(f"{k} {e}\n" for k, e in enumerate(elements, 1)) + "$EndElements\n")


def ranks_of(arguments):
    """What `--ranks` says; else 2."""
    return int(arguments[arguments.index("--ranks") + 1]) if "--ranks" in arguments else 2


def run(program, command, case, ranks=1, options=(), status=0, errors=False):
    """Runs a command of the program, on one rank without mpirun, whose start takes half a second; ends the test if the exit status is another than expected. Returns stdout, or stderr."""
    line = [*(["mpirun", "--oversubscribe", "-n", str(ranks)] if ranks > 1 else []), program, command, str(case), *options]
    done = subprocess.run(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode != status:
        sys.exit(f"{' '.join(line)}\nended with {done.returncode} instead of {status}\n{done.stdout}\n{done.stderr}")
    return done.stderr if errors else done.stdout


def left_behind(folder, case, command, h5=("case/title",), xdmf=True):
    """Requires what every run leaves: results.h5 with the case file, the revision and the datasets `h5`, an .xdmf that fits it, the same in result.json, and a log."""
    with h5py.File(folder / "results.h5") as file:
        text = file["case/text"][()].decode()
        missing = [name for name in (*h5, "program/git_revision") if name not in file]
    result = json.loads((folder / "result.json").read_text())
    require(not missing and text == case.read_text(), f"{folder.name}/results.h5 has the case file, the revision and what is drawn {missing}")
    require(result["case_text"] == text and result["program"]["git_revision"] and result["case_file"].endswith(case.name), f"{folder.name}/result.json has them, too")
    if xdmf:
        fits = subprocess.run([sys.executable, str(SOURCE / "tests/io/check_xdmf.py"), str(folder / "results.xdmf")], stdout=subprocess.PIPE).returncode
        require(fits == 0, f"{folder.name}/results.xdmf fits it")
    if command:
        log = (folder / "log.txt").read_text().splitlines()
        require(f" imic3d {command} " in log[0], f"{folder.name}/log.txt: {log[0]}")


def same_page(program, folder):
    """Requires that `imic3d report` makes the page of a run again."""
    page = (folder / "report.html").read_text()
    (folder / "report.html").unlink()
    run(program, "report", folder)
    require((folder / "report.html").read_text() == page, f"the page of {folder.name} is made again")


def figures(folder, names):
    """Requires that tools/plot_loop.py makes these figures of a loop."""
    subprocess.run([sys.executable, str(SOURCE / "tools/plot_loop.py"), str(folder / "results.h5"), "--folder", str(folder / "figures")], check=True)
    missing = [name for name in names if not (folder / "figures" / name).exists()]
    require(not missing, f"tools/plot_loop.py draws {', '.join(names)} of {folder.name} {missing}")


def require(condition, message):
    print(("passed  " if condition else "FAILED  ") + message, flush=True)
    if not condition:
        require.failed = True


require.failed = False


def workspace(name):
    """A new folder, which end() removes where nothing failed."""
    workspaces.append(pathlib.Path(tempfile.mkdtemp(prefix=f"imic3d_{name}_")))
    return workspaces[-1]


workspaces = []


def end(keep=False):
    for folder in workspaces:
        if keep or require.failed:
            print(folder)
        else:
            shutil.rmtree(folder, ignore_errors=True)
    sys.exit(1 if require.failed else 0)


def data():
    """The folder of the measured data, or None."""
    folder = pathlib.Path(os.environ.get("IMIC3D_DATA", SOURCE.parent / "shared/data"))
    return folder if folder.is_dir() else None
