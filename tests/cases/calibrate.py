#!/usr/bin/python3
"""imic3d calibrate on images that are drawn here: a rig of two cameras without distortion looks at a chessboard.

Usage: calibrate.py EXECUTABLE

The good file runs on 1 and 3 ranks with equal results near the truth. Each row of the table then spoils one thing and says
what the program must answer: status 2 on every rank, and the golden lines as the last ones of stderr.
"""
import json
import os
import re
import shutil
import subprocess
import sys

import numpy
from PIL import Image

from runs import end, require, run, workspace

CASE = """title: Drawn rig
target: {type: chessboard, rows: 6, columns: 8, spacing: 9, unit: mm}
cameras:
  - {name: left, images: "left/*.png"}
  - {name: right, images: ["right/*.png"]}
distortion: [k1]
output: out
"""
FRAMES, COLUMNS, ROWS = 7, 360, 300
ROWS_OF_CORNERS, CORNERS_IN_ROW, SPACING = 6, 8, 9.0
FOCAL, CENTRE = {"left": 800.0, "right": 820.0}, {"left": (181.0, 148.0), "right": (175.0, 152.0)}
BLANK = {("right", 3)}  # no target to be seen


def rotation(x, y, z):
    """Rz Ry Rx."""
    cx, sx, cy, sy, cz, sz = numpy.cos(x), numpy.sin(x), numpy.cos(y), numpy.sin(y), numpy.cos(z), numpy.sin(z)
    return (numpy.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ numpy.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
            @ numpy.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]))


RIG = {"left": (numpy.eye(3), numpy.zeros(3)), "right": (rotation(0.01, -0.3, 0.02), None)}
RIG["right"] = (RIG["right"][0], numpy.array([1.0, -2.0, 304.0]) - RIG["right"][0] @ [0, 0, 300.0])


def draw(camera, frame, path):
    """Mean over 6 x 6 places in each pixel (drawn at random, each in its part: a regular grid would see edges along the pixels
    in steps), a slight blur, noise of 1.5 grey levels, quantised."""
    random = numpy.random.default_rng([frame, len(camera)])
    pose = numpy.random.default_rng(50 + frame).uniform(-1, 1, 6)
    R = rotation(0.45 * pose[0], 0.4 * pose[1], 0.3 * pose[2])
    middle = SPACING / 2 * numpy.array([CORNERS_IN_ROW - 1, ROWS_OF_CORNERS - 1, 0])
    t = numpy.array([8 * pose[3], 6 * pose[4], 300 + 15 * pose[5]]) - R @ middle
    R, t = RIG[camera][0] @ R, RIG[camera][0] @ t + RIG[camera][1]
    column, row = numpy.meshgrid(numpy.arange(6 * COLUMNS), numpy.arange(6 * ROWS))
    column, row = [(index + random.uniform(size=index.shape)) / 6 - 0.5 for index in (column, row)]
    x, y = (column - CENTRE[camera][0]) / FOCAL[camera], (row - CENTRE[camera][1]) / FOCAL[camera]
    ray = numpy.stack([x, y, numpy.ones_like(x)], -1) @ R  # in the target's frame: R^T ray
    origin = -R.T @ t
    at = origin[:2] - origin[2] * ray[..., :2] / ray[..., 2:]
    i, j = numpy.floor(at[..., 0] / SPACING).astype(int), numpy.floor(at[..., 1] / SPACING).astype(int)
    dark = (i >= -1) & (i < CORNERS_IN_ROW) & (j >= -1) & (j < ROWS_OF_CORNERS) & ((i + j) % 2 == 1)
    grey = numpy.where(dark & ((camera, frame) not in BLANK), 50.0, 200.0)
    grey = grey.reshape(ROWS, 6, COLUMNS, 6).mean((1, 3))
    for axis in (0, 1):
        grey = 0.6 * grey + 0.2 * (numpy.roll(grey, 1, axis) + numpy.roll(grey, -1, axis))
    grey += random.normal(0, 1.5, (ROWS, COLUMNS))
    path.parent.mkdir(exist_ok=True, parents=True)
    Image.fromarray(grey.round().clip(0, 255).astype(numpy.uint8)).save(path)


def change(old, new):
    def apply(folder):
        text = (folder / "calibration.yaml").read_text()
        assert text.count(old) == 1, old
        (folder / "calibration.yaml").write_text(text.replace(old, new))
    return apply


def blank(folder, camera, frames):
    for frame in frames:
        Image.new("L", (COLUMNS, ROWS), 128).save(folder / camera / f"image_{frame}.png")


TABLE = [
    ("unknown_key", change("rows: 6", "row: 6"),
     ["calibration.yaml:2 target.rows: not given; allowed: an integer from 2 to 200",
      "calibration.yaml:2 target.row: unknown key, near to rows; allowed: columns, diameter, rows, spacing, type, unit"]),
    ("unknown_target", change("chessboard", "chess"),
     ['calibration.yaml:2 target.type: "chess"; allowed: chessboard, circles, asymmetric_circles']),
    ("negative_spacing", change("spacing: 9", "spacing: -9"),
     ["calibration.yaml:2 target.spacing: -9; allowed: a positive number"]),
    ("diameter_of_a_chessboard", change("spacing: 9", "spacing: 9, diameter: 3"),
     ["calibration.yaml:2 target.diameter: of a chessboard; allowed: circles only"]),
    ("circles_that_overlap", change("type: chessboard, rows: 6", "type: circles, diameter: 9, rows: 6"),
     ["calibration.yaml:2 target.diameter: 9; allowed: less than the way to the next circle, 9"]),
    ("unknown_term", change("[k1]", "[k1, k9]"),
     ['calibration.yaml:6 distortion[1]: "k9"; allowed: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4']),
    ("term_twice", change("[k1]", "[k1, k1]"), ['calibration.yaml:6 distortion[1]: "k1" again; allowed: a term once']),
    ("name_twice", change("name: right", "name: left"),
     ['calibration.yaml:5 cameras[1].name: "left" again; allowed: a name once']),
    ("no_images", change("left/*.png", "lift/*.png"),
     ['calibration.yaml:4 cameras[0].images: no file "lift/*.png"; allowed: images that exist']),
    ("a_number_for_images", change('"left/*.png"', "3"),
     ['calibration.yaml:4 cameras[0].images: 3; allowed: a pattern such as "left/*.tif", or a list of them']),
    ("one_image_less", lambda folder: (folder / "right/image_6.png").unlink(),
     ["calibration.yaml:5 cameras[1].images: 6 images; allowed: 7 as of camera left: the k-th images belong together"]),
    ("another_size", lambda folder: Image.new("L", (COLUMNS, ROWS + 1), 128).save(folder / "left/image_2.png"),
     ["left/image_2.png: 360 x 301 px; allowed: 360 x 300 px as left/image_0.png"]),
    ("not_an_image", lambda folder: (folder / "left/image_2.png").write_text("this is no image at all " * 4),
     ["left/image_2.png: not an image; allowed: a PNG, TIFF or BMP image"]),
    ("too_few", lambda folder: blank(folder, "left", range(5)),
     ["camera left: the target was found in 2 of 7 images; allowed: at least 3"]),
    ("another_target", change("columns: 8", "columns: 9"),
     ["camera left: the target was found in 0 of 7 images; allowed: at least 3",
      "camera right: the target was found in 0 of 7 images; allowed: at least 3"]),
    ("never_together", lambda folder: (blank(folder, "left", range(4)), blank(folder, "right", range(4, 7))),
     ["camera right: no image of the target at the same time as left; allowed: at least 1"]),
    ("a_folder_that_cannot_be_made", lambda folder: (folder / "out").write_text("a file"),
     [r"re:.*out: cannot be made: .*; allowed: a folder that can be written to"]),
    ("not_yaml", change("cameras:", "cameras: ["), [r"re:calibration\.yaml:\d+: not YAML at column \d+: .*"]),
]


def answer(program, folder, ranks=2):
    """Statuses of the ranks and the lines of stderr."""
    command = ["mpirun", "--oversubscribe", "-n", str(ranks), "sh", "-c", '"$0" calibrate "$1"; echo "exit status $?"', program,
               str(folder / "calibration.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    return re.findall(r"^exit status (\d+)$", done.stdout, re.M), done.stderr.replace(f"{folder}/", "").splitlines()


def main():
    program = os.path.abspath(sys.argv[1])
    folder = workspace("calibrate")
    good = folder / "good"
    for camera in ("left", "right"):
        for frame in range(FRAMES):
            draw(camera, frame, good / camera / f"image_{frame}.png")
    (good / "calibration.yaml").write_text(CASE)

    results = {}
    for ranks in (1, 3):
        output = folder / f"out_{ranks}"
        run(program, "calibrate", good / "calibration.yaml", ranks, ["--output", str(output)])
        results[ranks] = json.loads((output / "result.json").read_text())
    result = results[1]
    require(results[3] == result, "3 ranks and 1 find the same")
    left, right = result["cameras"]
    require(left["found"] == 7 and right["found"] == 6 and right["not_found"] == ["image_3.png"], "the blank image is left out by name")
    rms = result["rms_reprojection_error"]["value"]
    require(0.002 < rms < 0.05, f"reprojection error {rms:.4f} px")
    truth = {f"{c} {n}": v for c in FOCAL for n, v in (("fx", FOCAL[c]), ("fy", FOCAL[c]), ("cx", CENTRE[c][0]), ("cy", CENTRE[c][1]), ("k1", 0.0))}
    truth |= {f"right {n}": v for n, v in zip(("tx", "ty", "tz"), RIG["right"][1])}
    worst = 0.0
    for name, value in truth.items():
        camera, number = name.split()
        found = (left if camera == "left" else right)["numbers"][number]
        require(found["standard_deviation"] > 0.0, f"{name} has a standard deviation")
        worst = max(worst, abs(found["value"] - value) / found["standard_deviation"])
    require(worst < 4.0, f"all numbers within {worst:.2f} standard deviations of the truth")
    distance = right["distance_from_first"]
    require(abs(distance["value"] - numpy.linalg.norm(RIG["right"][1])) < 4 * distance["standard_deviation"], f"distance {distance['value']:.3f} mm")
    page = (folder / "out_1/calibration.html").read_text()
    require(page.count("data:image/jpeg;base64") == 14 and "http://" not in page.replace("http://www.w3.org", ""), "the page holds all pictures itself")
    require("right: image_3.png" in page, "the page names the blank image")
    require((folder / "out_1/calibration.yaml").read_text().startswith("%YAML"), "the calibration is OpenCV's YAML")

    for name, spoil, golden in TABLE:
        case = folder / name
        shutil.copytree(good, case)
        spoil(case)
        statuses, lines = answer(program, case)
        said = lines[-len(golden):]
        same = len(said) == len(golden) and all(re.fullmatch(g[3:], s) if g.startswith("re:") else g == s for g, s in zip(golden, said))
        require(statuses == ["2", "2"] and same, f"{name}: {statuses} {said}")
    end()


main()
