#!/usr/bin/python3
"""Bad input: each row of the table spoils one thing of a good small case and says what the program must answer.

Usage: bad_input.py EXECUTABLE [--ranks 2] [--only NAME] [--limit SECONDS] [--jobs 2] [--keep FOLDER] [--launcher "mpirun ..."]

For each row `EXECUTABLE check case.yaml` runs on some ranks. Every rank must end with status 2; stderr must be the golden
lines and nothing else (so rank 0 alone speaks); the time from the start of the ranks must stay below the limit. The good
case itself must pass with status 0, without a warning; what is only doubted passes with one warning. A golden line that starts with "re:" is a regular expression.
"""
import argparse
import concurrent.futures
import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time

import numpy
from PIL import Image

CASE = """# yaml-language-server: $schema=case.schema.json
title: A small strip
units: {length: mm, force: N, time: s}
specimen: {mesh: strip.msh, thickness: 1.5, layers: 2, held: bottom, loaded: top, axis: y}
cameras:
  - name: left
    pixel_size: 0.04
    place: {points: [[0, -3, 70, 170], [0, 3, 70, 20]]}
    images: "images/*.png"
loads: {file: loads.csv, image: frame, time: t_s, force: F_N}
material:
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {E: 198e3, nu: 0.25, S_y: 284, H: 1480, delta: 0.042}
identify:
  functional: force_driven
  stages:
    - {free: [E], frames: "1-3"}
    - {free: [S_y, H, delta], frames: "1-5"}
"""
FRAMES, COLUMNS, ROWS = 6, 140, 190
NX, NY = 4, 6  # squares of 1 mm, about the origin


def speckle(seed=1, columns=COLUMNS, rows=ROWS, top=255):
    noise = numpy.random.default_rng(seed).normal(size=(rows, columns))
    for axis in (0, 1):  # three box blurs make speckles of some pixels
        for _ in range(3):
            noise = (noise + numpy.roll(noise, 1, axis) + numpy.roll(noise, -1, axis)) / 3
    noise = (noise - noise.min()) / (noise.max() - noise.min())
    return noise * top


def write_image(path, columns=COLUMNS, rows=ROWS, bits=8, seed=1):
    values = speckle(seed, columns=columns, rows=rows, top=2**bits - 1)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(values.astype(numpy.uint8 if bits == 8 else numpy.uint16)).save(path)


def write_mesh(path, moved=(), merged=()):
    """Gmsh 2.2. moved: {node: (x, y)}; merged: {node: the node that stands in its place in every element}."""
    moved, merged = dict(moved), dict(merged)

    def node(i, j):
        return 1 + j * (NX + 1) + i

    nodes = {node(i, j): (i - NX / 2, j - NY / 2) for j in range(NY + 1) for i in range(NX + 1)}
    nodes.update(moved)
    elements = [(1, 1, [node(i, 0), node(i + 1, 0)]) for i in range(NX)]
    elements += [(1, 2, [node(i, NY), node(i + 1, NY)]) for i in range(NX)]
    elements += [(3, 3, [node(i, j), node(i + 1, j), node(i + 1, j + 1), node(i, j + 1)])
                 for j in range(NY) for i in range(NX)]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", "3", '1 1 "bottom"', '1 2 "top"',
             '2 3 "specimen"', "$EndPhysicalNames", "$Nodes", str(len(nodes))]
    lines += [f"{n} {x} {y} 0" for n, (x, y) in nodes.items()]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    lines += [f"{i + 1} {kind} 2 {group} {group} " + " ".join(str(merged.get(n, n)) for n in corners)
              for i, (kind, group, corners) in enumerate(elements)]
    path.write_text("\n".join(lines + ["$EndElements", ""]))


def loosen(path):
    """One more element, beside the strip."""
    text = path.read_text()
    nodes, elements = (NX + 1) * (NY + 1), 2 * NX + NX * NY
    corners = "\n".join(f"{nodes + 1 + k} {5 + x} {y} 0" for k, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)]))
    text = text.replace(f"$Nodes\n{nodes}\n", f"$Nodes\n{nodes + 4}\n").replace("$EndNodes", corners + "\n$EndNodes")
    text = text.replace(f"$Elements\n{elements}\n", f"$Elements\n{elements + 1}\n")
    path.write_text(text.replace("$EndElements", f"{elements + 1} 3 2 3 3 " + " ".join(str(nodes + 1 + k) for k in range(4)) + "\n$EndElements"))


def write_good_case(folder):
    folder.mkdir(parents=True)
    (folder / "case.yaml").write_text(CASE)
    (folder / "loads.csv").write_text("frame,t_s,F_N\n" + "".join(f"{i},{i}.0,{100 * i}\n" for i in range(FRAMES)))
    write_mesh(folder / "strip.msh")
    for i in range(FRAMES):
        write_image(folder / f"images/frame_{i}.png", seed=1 + i)


def change(name, old, new):
    """Replaces a text that is there exactly once in a file of the case."""
    def apply(folder):
        text = (folder / name).read_text()
        assert text.count(old) == 1, (name, old, text.count(old))
        (folder / name).write_text(text.replace(old, new))
    return apply


def both(*changes):
    return lambda folder: [apply(folder) for apply in changes]


def image(number, **options):
    return lambda folder: write_image(folder / f"images/frame_{number}.png", **options)


def cut(name, size):
    return lambda folder: os.truncate(folder / name, (folder / name).stat().st_size - size)


def mesh(**options):
    return lambda folder: write_mesh(folder / "strip.msh", **options)


# Name, what is spoilt, the lines that must be said.
TABLE = [
    ("missing_image", lambda folder: (folder / "images/frame_3.png").unlink(),
     ["case.yaml:9 cameras[0].images: 5 images; allowed: 6, one for each row of loads.csv; else say which they are: frames: "
      "from_names, or a list",
      "case.yaml:19 identify.stages[1].frames: frames 1-5; allowed: among the frames 0-4"]),
    ("missing_image_named_in_the_record",
     both(change("case.yaml", '"images/*.png"', "from_loads"),
          lambda folder: (folder / "loads.csv").write_text(
              "frame,t_s,F_N,image_file\n" + "".join(f"{i},{i},1,images/frame_{i}.png\n" for i in range(FRAMES))),
          lambda folder: (folder / "images/frame_3.png").unlink()),
     ["images/frame_3.png: no such file; allowed: an image"]),
    ("no_images", change("case.yaml", "images/*.png", "pictures/*.png"),
     ['case.yaml:9 cameras[0].images: no file "pictures/*.png"; allowed: images that exist']),
    ("unreadable_image", lambda folder: (folder / "images/frame_3.png").write_text("this is no image at all " * 4),
     ["images/frame_3.png: not an image; allowed: a PNG, TIFF or BMP image"]),
    ("incomplete_image", cut("images/frame_3.png", 100),
     ["images/frame_3.png: an incomplete file; allowed: a whole image"]),
    ("image_of_another_size", image(3, columns=130),
     ["images/frame_3.png: 130 x 190 px; allowed: 140 x 190 px as in images/frame_0.png"]),
    ("image_of_another_bit_depth", image(3, bits=16),
     ["images/frame_3.png: 16 bits; allowed: 8 bits as in images/frame_0.png"]),
    ("loads_with_a_missing_frame", change("loads.csv", "3,3.0,300\n", ""),
     ["loads.csv: no row for frame 3 (images/frame_3.png); allowed: a row for each image"]),
    ("loads_with_nan", change("loads.csv", "3,3.0,300", "3,3.0,nan"),
     ['loads.csv:5 column "F_N": nan; allowed: a finite number']),
    ("loads_with_a_text", change("loads.csv", "3,3.0,300", "3,3.0,three"),
     ['loads.csv:5 column "F_N": three; allowed: a finite number']),
    ("loads_of_one_column", change("case.yaml", "force: F_N", "force: t_s"),
     ["case.yaml:10 loads.force: t_s, which is time, too; allowed: another column for each"]),
    ("loads_without_the_column", change("case.yaml", "force: F_N", "force: F_kN"),
     ['loads.csv:1 column "F_kN": not there; allowed: one of "frame", "t_s", "F_N"']),
    ("loads_with_unsorted_time", change("loads.csv", "3,3.0,300", "3,1.5,300"),
     ['loads.csv:5 column "t_s": 1.5 after 2.0; allowed: a time that does not decrease']),
    ("loads_with_a_frame_twice", change("loads.csv", "3,3.0,300", "2,3.0,300"),
     ['loads.csv:5 column "frame": 2; allowed: a frame once (it stands in line 4 too)']),
    ("hardening_of_another_name", change("case.yaml", "hardening: power_linear", "hardening: Voce"),
     ['case.yaml:12 material.hardening: "Voce"; allowed: power_linear, linear, voce, swift, table']),
    ("tied_without_a_power", change("case.yaml", "hardening: power_linear", "hardening: linear"),
     ["case.yaml:13 material.tie_initial_modulus: true with hardening linear; allowed: true with hardening power_linear (Eq. 19), or false"]),
    ("loads_by_no_clock", change("case.yaml", "image: frame, time: t_s", "time: t_s, frame_times: {start: 0}"),
     ["case.yaml:10 loads.frame_times: neither interval nor file; allowed: one of the two"]),
    ("loads_by_frames_and_a_clock", change("case.yaml", "image: frame, time: t_s", "image: frame, time: t_s, frame_times: {interval: 1}"),
     ["case.yaml:10 loads.image: given beside frame_times; allowed: one of the two"]),
    ("loads_that_end_too_early", change("case.yaml", "image: frame, time: t_s", "time: t_s, frame_times: {interval: 1.2}"),
     ["loads.csv: no row for frame 5 (images/frame_5.png); allowed: images that were taken while the record ran (frame_times)"]),
    ("loads_of_another_day", change("case.yaml", "image: frame, time: t_s", "time: t_s, frame_times: {interval: 1, start: 86400}"),
     ["loads.csv: a record from 0 to 5; allowed: one that runs while images are taken (frame_times)"]),
    ("loads_missing", change("case.yaml", "loads.csv", "load.csv"),
     ["case.yaml:10 loads.file: no such file: load.csv; allowed: a table, e.g. a .csv file"]),
    ("mesh_missing", change("case.yaml", "strip.msh", "stripe.msh"),
     ["case.yaml:4 specimen.mesh: no such file: stripe.msh; allowed: a .msh or .inp file"]),
    ("mesh_with_an_inverted_element", mesh(moved={13: (0.9, 0.9)}),
     ["strip.msh element 18 at (-0.275, -0.025, 0): inverted: negative Jacobian at 1 of 4 corners; allowed: a convex, "
      "counter-clockwise quadrilateral",
      "strip.msh element 19 at (0.725, -0.025, 0): inverted: negative Jacobian at 2 of 4 corners; allowed: a convex, "
      "counter-clockwise quadrilateral"]),
    ("mesh_with_a_degenerate_element", mesh(merged={13: 14}),
     ["strip.msh element 15 at (0.75, -1.5, 0): the same node twice (degenerate); allowed: a convex, counter-clockwise "
      "quadrilateral",
      "strip.msh element 19 at (0.75, -0.5, 0): the same node twice (degenerate); allowed: a convex, counter-clockwise "
      "quadrilateral"]),
    ("mesh_not_on_the_image", both(change("case.yaml", "[0, -3, 70, 170]", "[0, -3, 130, 170]"),
                                   change("case.yaml", "[0, 3, 70, 20]", "[0, 3, 130, 20]")),
     ["cameras.left.place: a mesh that does not lie on the image: 14 of 35 nodes are outside; columns 80.0 to 180.0, rows 20.0 to 170.0; "
      "allowed: columns 0 to 139, rows 0 to 189"]),
    ("unknown_group", change("case.yaml", "held: bottom", "held: botom"),
     ['case.yaml:4 specimen.held: no group "botom", near to bottom; allowed: bottom, top']),
    ("negative_thickness", change("case.yaml", "thickness: 1.5", "thickness: -8"),
     ["case.yaml:4 specimen.thickness: -8; allowed: a positive number [mm]"]),
    ("thickness_that_is_nan", change("case.yaml", "thickness: 1.5", "thickness: .nan"),
     ["case.yaml:4 specimen.thickness: .nan; allowed: a finite number"]),
    ("no_thickness", change("case.yaml", "thickness: 1.5, ", ""),
     ["case.yaml:4 specimen.thickness: not given; allowed: a positive number [mm]"]),
    ("element_of_a_plane_in_3d", change("case.yaml", "layers: 2", "element: quad8"),
     ["case.yaml:4 specimen.element: quad8 with kinematics: 3d; allowed: hex8, hex8r, hex8s, hex20; quad4, quad8 with kinematics: plane_stress"]),
    ("unknown_kinematics", change("case.yaml", "layers: 2", "kinematics: plane_strain"),
     ['case.yaml:4 specimen.kinematics: "plane_strain"; allowed: 3d, plane_stress']),
    ("unknown_key", change("case.yaml", "layers: 2", "layer: 2"),
     ["case.yaml:4 specimen.layer: unknown key, near to layers; allowed: axis, element, front, held, kinematics, layer_ratio, layers, loaded, mesh, "
      "mid_plane_symmetry, place, refine, thickness"]),
    ("duplicate_key", change("case.yaml", "layers: 2", "layers: 2, layers: 3"),
     ["case.yaml:4 specimen.layers: key given twice (first in line 4); allowed: each key once"]),
    ("parameter_that_is_a_text", change("case.yaml", "E: 198e3", "E: 198 GPa"),
     [r're:case\.yaml:14 material\.parameters\.E: "198 GPa"; allowed: .*']),
    ("mesh_with_a_loose_part", lambda folder: loosen(folder / "strip.msh"),
     ["case.yaml:4 specimen.mesh: 1 of 25 elements share no node with the others, nor belong to held or loaded; allowed: elements that hang together (nodes at one place are to be merged)"]),
    ("parameter_outside_its_bounds", change("case.yaml", "S_y: 284", "S_y: {value: 284, lower: 300, upper: 400}"),
     ["case.yaml:14 material.parameters.S_y: value 284; allowed: a value between its bounds, from 300, up to 400"]),
    ("parameter_that_no_material_has", change("case.yaml", "nu: 0.25", "nu: 0.75"),
     [r"re:case\.yaml:14 material\.parameters\.nu: 0\.75; allowed: a number .*"]),
    ("unknown_parameter", change("case.yaml", "free: [E]", "free: [e_mod]"),
     ['case.yaml:18 identify.stages[0].free[0]: no parameter "e_mod"; allowed: E, nu, S_y, H, delta']),
    ("frames_beyond_the_last", change("case.yaml", '"1-5"', '"1-50"'),
     ["case.yaml:19 identify.stages[1].frames: frames 1-50; allowed: among the frames 0-5"]),
    ("groups_that_are_no_number", change("case.yaml", "functional: force_driven", "groups: all"),
     [r're:case\.yaml:\d+ identify\.groups: "all"; allowed: auto, or a number of groups']),
    ("increments_that_are_none", change("case.yaml", "functional: force_driven", "steps_per_frame: 0"),
     [r're:case\.yaml:\d+ identify\.steps_per_frame: 0; allowed: auto, or a number of increments']),
    ("rows_that_count_upwards", change("case.yaml", "[[0, -3, 70, 170], [0, 3, 70, 20]]", "[[-2, -3, 20, 20], [2, -3, 120, 20], [2, 3, 120, 170]]"),
     ["place.points: a mirrored image; allowed: rows counted from the top downwards and columns from the left, or the other value of flip"]),
    ("mesh_in_another_unit", both(change("case.yaml", "[[0, -3, 70, 170], [0, 3, 70, 20]]", "[[0, -300, 70, 170], [0, 300, 70, 20]]"), change("case.yaml", "pixel_size: 0.04", "pixel_size: 4")),
     ["cameras.left.place: a mesh that covers 1 x 1.5 px of an image of 140 x 190; allowed: 30 px and more on its longer side: are the mesh and pixel_size in the units of the case file?"]),
    ("quarter_turn", lambda folder: (slanted("{auto: outline}")(folder), paint(numpy.rot90)(folder)),
     [r"re:cameras\.left\.place\.auto: no place in the reference image .*, or place\.points; of an image that is turned or mirrored the outline tells a place in the mirrored image: "
      r"0\.04\d* is the length of a pixel, .* place: \{auto: outline, rotation: -?90, flip: true\} takes these \(220 of 220 .*"]),
    ("black_reference", lambda folder: Image.new("L", (COLUMNS, ROWS), 7).save(folder / "images/frame_0.png"),
     ["images/frame_0.png: one grey level throughout; allowed: a picture of the specimen, as a reference of cameras.left"]),
    ("jpeg", lambda folder: Image.fromarray(speckle().astype(numpy.uint8)).save(folder / "images/frame_3.png", format="jpeg"),
     ["images/frame_3.png: a JPEG image, which has lost noise and gained patterns; allowed: a PNG, TIFF or BMP image"]),
    ("not_yaml", change("case.yaml", "specimen: {", "specimen: [{"),
     [r"re:case\.yaml:\d+: not YAML at column \d+: .*"]),
    ("several_mistakes_in_one_go", both(change("case.yaml", "thickness: 1.5", "thickness: 0"),
                                        change("case.yaml", "axis: y", "axis: z"),
                                        change("loads.csv", "3,3.0,300", "3,3.0,")),
     ["case.yaml:4 specimen.axis: \"z\"; allowed: x, y",
      "case.yaml:4 specimen.thickness: 0; allowed: a positive number [mm]",
      'loads.csv:5 column "F_N": nothing; allowed: a finite number']),
]


def paint(picture):
    """What becomes of each image's grey levels."""
    def apply(folder):
        for path in sorted(folder.glob("images/*.png")):
            Image.fromarray(picture(numpy.array(Image.open(path)).astype(float)).astype(numpy.uint8)).save(path)
    return apply


def before_darkness(grey):
    """The strip alone, bright, 101 x 151 px: 0.0397 mm per pixel."""
    alone = numpy.zeros_like(grey)
    alone[20:171, 20:121] = 120 + grey[20:171, 20:121] / 2
    return alone


SLANTED = {1 + j * (NX + 1) + i: (max(i - 2, 0) * (1 - j / 10) + min(i - 2, 0), j - 3) for j in range(NY + 1) for i in range(NX + 1)}


def slanted_upside_down(grey):
    """The strip whose right side goes inwards on its way up (SLANTED), as a camera with its rows counted upwards shows it."""
    alone = numpy.zeros_like(grey)
    for row in range(20, 171):
        right = 120 - round(20 * (row - 20) / 100)
        alone[row, 20:right + 1] = 120 + grey[row, 20:right + 1] / 2
    return alone


def with_a_blank(grey):
    """Nothing in the four elements about (1, 1)."""
    grey[40:100, 64:126] = 90
    return grey


def slanted(place):
    """It and its mesh, placed so."""
    return both(mesh(moved=SLANTED), change("case.yaml", "{points: [[0, -3, 70, 170], [0, 3, 70, 20]]}", place), paint(slanted_upside_down))


ANOTHER = (r"tells another place( in the mirrored image)?: 0\.0(39[5-9]|40?[0-4]?)\d* is the length of a pixel, the origin lies at \((69\.[5-9]|70\.[0-5]), (94\.[5-9]|95\.[0-5])\), turned by -?(179|180)\.\d+ degrees\. "
           r"place: \{auto: outline, rotation: 180, flip: true\} takes these \(220 of 220 edge points agree, rms 0\.\d+ px\)")
BACKGROUND = r"re:cameras\.left: [78]\S* % of the specimen's pixels have the smallest grey level .*"

# What may be meant: a name, what is done to the good case, the warnings.
DOUBTED = [
    ("image_twice", lambda folder: shutil.copy(folder / "images/frame_2.png", folder / "images/frame_3.png"),
     ["images/frame_2.png and frame_3.png are the same picture: was a frame written twice?"]),
    ("point_amiss", change("case.yaml", "[[0, -3, 70, 170], [0, 3, 70, 20]]", "[[-2, -3, 20, 170], [2, -3, 120, 170], [2, 3, 124, 20], [-2, 3, 20, 20]]"),
     ["cameras.left.place.points: they lie 1.00 px (rms) off the affine map that fits them best: one of them may be in a wrong place of the specimen or of the image"]),
    ("point_amiss_of_three", change("case.yaml", "[[0, -3, 70, 170], [0, 3, 70, 20]]", "[[-2, -3, 20, 170], [2, -3, 120, 170], [2, 3, 120, 26]]"),
     ["cameras.left.place.points make the image 4 % larger in one direction than across it: one of them may be in a wrong place of the specimen or of the image"]),
    ("small_elements", both(change("case.yaml", "[[0, -3, 70, 170], [0, 3, 70, 20]]", "[[0, -12, 70, 161], [0, 12, 70, 29]]"), change("case.yaml", "pixel_size: 0.04", "pixel_size: 0.18")),
     ["an element of the surface has 30 pixels in the mean, where 36 and more are wanted: a coarser mesh, or dic.regularisation (waves shorter than some elements) helps"]),
    ("scale", both(change("case.yaml", "{points: [[0, -3, 70, 170], [0, 3, 70, 20]]}", "{origin: [70, 95]}"), change("case.yaml", "pixel_size: 0.04", "pixel_size: 0.042"), paint(before_darkness)),
     [r"re:cameras\.left\.place: the outline in the reference lies up to 5\.\d px beside the mesh's, and tells another place: 0\.039[67]\d* is the length of a pixel, the origin lies at \(70\.0, 95\.0\), .* place: \{auto: outline\} without pixel_size takes these .*"]),
    ("scale_as_it_is", both(change("case.yaml", "{points: [[0, -3, 70, 170], [0, 3, 70, 20]]}", "{origin: [70, 95]}"), paint(before_darkness)), []),
    ("upside_down", slanted("{origin: [70, 95]}"), ["re:" + re.escape("cameras.left.place: the outline in the reference is not where the mesh has it, and ") + ANOTHER, BACKGROUND]),
    ("upside_down_outline", slanted("{auto: outline, flip: true}"), [r"re:cameras\.left\.place: \d+ of \d+ edge points agree with the outline, which " + ANOTHER, BACKGROUND]),
    ("upside_down_as_proposed", slanted("{auto: outline, rotation: 180, flip: true}"), []),
    ("blank", both(change("case.yaml", "pixel_size: 0.04", "pixel_size: 0.04\n    noise: 1"), paint(with_a_blank)),
     ["cameras.left: 4 of 24 elements show no speckle, but noise, about (1, 1) mm: does the mesh cover a hole, a shadow or the background? What moves there is not seen"]),
    ("pixel_size_in_microns", change("case.yaml", "pixel_size: 0.04", "pixel_size: 40"),
     ["cameras.left.pixel_size is 40 where the points make it 0.04, which is what is used: are they and the mesh in the units of the case file?"]),
]


def run(arguments, folder):
    """Statuses of the ranks, stderr's lines without the folder's name, warnings, seconds."""
    # The shell of each rank says its status, so that the launcher has no failure to comment on.
    script = '"$0" check "$1"; echo "exit status $?"'
    command = [*shlex.split(arguments.launcher), "-n", str(arguments.ranks), "sh", "-c", script, arguments.executable,
               str(folder / "case.yaml")]
    environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", OMPI_ALLOW_RUN_AS_ROOT="1",
                       OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1", HWLOC_HIDE_ERRORS="2")  # hwloc complains where there is no /sys
    start = time.monotonic()
    process = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, cwd=folder.parent)
    seconds = time.monotonic() - start
    said = process.stderr.replace(f"{folder}/", "")
    warnings = re.findall(r"^\[.*\] warning (.*)$", said, re.M)
    return re.findall(r"^exit status (\d+)$", process.stdout, re.M), said.splitlines(), warnings, seconds


def fits(golden, line):
    return re.fullmatch(golden[3:], line) is not None if golden.startswith("re:") else golden == line


def faults(statuses, lines, seconds, golden, status, arguments):
    found = []
    if statuses != [str(status)] * arguments.ranks:
        found.append(f"exit status {statuses}, not {status} on {arguments.ranks} ranks")
    if golden is not None and (len(lines) != len(golden) or not all(map(fits, golden, lines))):
        found += ["said:"] + [f"  {line}" for line in lines] + ["golden:"] + [f"  {line}" for line in golden]
    if seconds > arguments.limit:
        found.append(f"{seconds:.2f} s, more than {arguments.limit} s")
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("executable", type=os.path.abspath)
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--only", help="the rows whose name has this in it")
    parser.add_argument("--limit", type=float, default=5.0, help="seconds for a run with the launcher's own start")
    parser.add_argument("--keep", type=pathlib.Path, help="a folder for the cases, kept")
    parser.add_argument("--launcher", default="mpirun --oversubscribe")
    parser.add_argument("--jobs", type=int, default=1, help="rows side by side")
    arguments = parser.parse_args()
    folder = (arguments.keep or pathlib.Path(tempfile.mkdtemp(prefix="imic3d_bad_input_"))).resolve()
    rows = [("good_case", lambda _: None, None, []), *((name, spoil, None, warnings) for name, spoil, warnings in DOUBTED), *((*row, []) for row in TABLE)]

    def answer(row):
        """What is wrong with the program's answer to a row, and how long it took."""
        name, spoil, golden, doubted = row
        case = folder / name
        shutil.rmtree(case, ignore_errors=True)
        write_good_case(case)
        spoil(case)
        statuses, lines, warnings, seconds = run(arguments, case)
        found = faults(statuses, lines, seconds, golden, 0 if golden is None else 2, arguments)
        if len(warnings) != len(doubted) or not all(map(fits, doubted, warnings)):
            found.append(f"warned {warnings}, not {doubted}")
        if golden is None and found:
            found += ["said:"] + [f"  {line}" for line in lines]
        return found, seconds

    rows = [row for row in rows if not arguments.only or arguments.only in row[0]]
    failed, longest = 0, 0.0
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        for (name, *_), (found, seconds) in zip(rows, pool.map(answer, rows)):
            failed, longest = failed + bool(found), max(longest, seconds)
            print(f"{'FAILED' if found else 'passed'}  {name}  {seconds:.2f} s", *found, sep="\n        ")
    if not arguments.keep:
        shutil.rmtree(folder)
    print(f"{failed} failed; the longest run took {longest:.2f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
