"""What the whole-run tests share: a folder, the meshes, and the program under mpirun."""
import os
import pathlib
import subprocess
import sys

SOURCE = pathlib.Path(__file__).resolve().parents[2]


def gmsh(script, output, **sizes):
    """Makes a mesh with a script of tools/meshes."""
    command = ["gmsh", "-2", "-v", "2", "-format", "msh41", str(SOURCE / "tools/meshes" / f"{script}.geo"), "-o", str(output)]
    for name, value in sizes.items():
        command[1:1] = ["-setnumber", name, str(value)]
    subprocess.run(command, check=True)


def run(program, command, case, ranks=1, options=(), status=0, errors=False):
    """Runs a command of the program; ends the test if the exit status is another than expected. Returns stdout, or stderr."""
    line = ["mpirun", "--oversubscribe", "-n", str(ranks), program, command, str(case), *options]
    done = subprocess.run(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if done.returncode != status:
        sys.exit(f"{' '.join(line)}\nended with {done.returncode} instead of {status}\n{done.stdout}\n{done.stderr}")
    return done.stderr if errors else done.stdout


def require(condition, message):
    print(("passed  " if condition else "FAILED  ") + message, flush=True)
    if not condition:
        require.failed = True


require.failed = False


def end():
    sys.exit(1 if require.failed else 0)


def data():
    """The folder of the measured data, or None."""
    folder = pathlib.Path(os.environ.get("IMIC3D_DATA", SOURCE.parent / "shared/data"))
    return folder if folder.is_dir() else None
