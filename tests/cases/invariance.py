#!/usr/bin/python3
"""One test, written in other units, on the other side of a mirror, turned, in negative, with more bits, elsewhere and at another hour: the measured displacement is the same, and so are its
parameters where the noise that smooths the ends is drawn alike, as in a mirror it is not. With --loop, of more of them: of a load cell that reads 200 N without load `imic3d loop` says the
same.

invariance.py PROGRAM [--loop]"""
import json
import pathlib
import sys

import h5py
import numpy as np
from PIL import Image

from runs import SOURCE, end, require, run, workspace

sys.path.insert(0, str(SOURCE / "tools"))
import false_alarms

PLACE, PIXEL, SIZE = (124.5, 159.5), 0.09, (250, 320)
MEGA, MILLI = 1e6, 1e-3


def moved_mesh(text, move):
    """A Gmsh 4.1 file with its nodes [n x 3] moved."""
    lines = text.splitlines()
    at = lines.index("$Nodes") + 1
    blocks, at = int(lines[at].split()[0]), at + 1
    for _ in range(blocks):
        count = int(lines[at].split()[3])
        for i in range(at + 1 + count, at + 1 + 2 * count):
            lines[i] = "{:.16g} {:.16g} {:.16g}".format(*move(np.array(lines[i].split(), float)))
        at += 1 + 2 * count
    return "\n".join(lines) + "\n"


def same(x):
    return x


# What becomes of the nodes, of a picture, of the record (frame, time, force) and of the case; what E is multiplied by.
VARIANTS = {
    "as it is": (same, same, (1, 1, 1), (0, 0, 0), {}, 1.0),
    "m and Pa": (lambda p: MILLI * p, same, (1, 1, 1), (0, 0, 0),
                 {"thickness: 0.8": "thickness: 8e-4", "pixel_size: 0.09": "pixel_size: 9e-5", "190e3": "190e9", "278": "278e6", "1420": "1420e6", "title:": "units: {length: m, force: N, time: s}\ntitle:"}, MEGA),
    "mm and kN": (same, same, (1, 1, MILLI), (0, 0, 0), {"190e3": "190", "278": "0.278", "1420": "1.42", "noise: 2}": "noise: 0.002}", "title:": "units: {length: mm, force: kN, time: s}\ntitle:"}, MILLI),
    "in a mirror": (lambda p: p * (-1, 1, 1), lambda grey: grey[:, ::-1], (1, 1, 1), (0, 0, 0), {str(list(PLACE)): str([SIZE[0] - 1 - PLACE[0], PLACE[1]])}, 1.0),
    "a quarter turn": (lambda p: p[[1, 0, 2]] * (1, -1, 1), lambda grey: np.rot90(grey, -1), (1, 1, 1), (0, 0, 0),
                       {str(list(PLACE)): str([SIZE[1] - 1 - PLACE[1], PLACE[0]]), "loaded: top": "loaded: top, axis: x"}, 1.0),
    "in negative": (same, lambda grey: 255 - grey, (1, 1, 1), (0, 0, 0), {}, 1.0),
    "16 bits": (same, lambda grey: 257 * grey.astype(np.uint16), (1, 1, 1), (0, 0, 0), {}, 1.0),
    "elsewhere": (lambda p: p + (900, -450, 0), same, (1, 1, 1), (0, 0, 0), {str(list(PLACE)): str([PLACE[0] - 900 / PIXEL, PLACE[1] - 450 / PIXEL])}, 1.0),
    "at another hour": (same, same, (1, 60, 1), (0, 1e6, 0), {}, 1.0),
}


def write(made, folder, variant, zero, more):
    """The test `made`, to be run in `folder`, with `more` changes of the case. `zero`: what the load cell reads without load [N]."""
    move, seen, scale, shift, changes, _ = variant
    changes = changes | more
    (folder / "test/images").mkdir(parents=True)
    (folder / "identify.msh").write_text(moved_mesh((made / "identify.msh").read_text(), move))
    for file in sorted((made / "test/images").iterdir()):
        Image.fromarray(np.ascontiguousarray(seen(np.array(Image.open(file))))).save(folder / "test/images" / f"{file.stem}.png")
    record = np.loadtxt(made / "test/loads.csv", delimiter=",", skiprows=1) + (0, 0, zero)
    np.savetxt(folder / "test/loads.csv", record * scale + shift, fmt="%.12g", delimiter=",", header="frame,time_s,force_N", comments="")
    case = (made / "case.yaml").read_text()
    for old, new in changes.items():
        assert old in case, old
        case = case.replace(old, new)
    (folder / "case.yaml").write_text(case)


program, loop = str(pathlib.Path(sys.argv[1]).resolve()), "--loop" in sys.argv
work = workspace("invariance")
made = work / "made"
made.mkdir()
false_alarms.images(program)(made, {}, 1)
first, moved_first = {}, None
for name, variant in VARIANTS.items():
    if not loop and name not in ("as it is", "m and Pa", "in a mirror", "a quarter turn", "16 bits"):
        continue
    folder = work / name.replace(" ", "_")
    write(made, folder, variant, 200.0 if loop else 0.0, {} if loop else {"displacement_driven,": "displacement_driven, noise_draws: 0,"})
    run(program, "loop" if loop else "identify", folder / "case.yaml")
    result = json.loads((folder / "run/result.json").read_text())
    if loop:
        require(result["verdict"] == "attributed" and result["named"] == ["force zero"], f"{name}: {result['sentence'][:240]}")
        continue
    # Nodes are numbered otherwise in a mirror: each is the one that lies where the move takes the first test's.
    move, turned = variant[0], name in ("in a mirror", "a quarter turn")
    with h5py.File(folder / "run/results.h5") as file:
        nodes, moved = file["surface/nodes"][:], file["dic/displacement"][:][5:]  # the first five are the reference
    if moved_first is None:
        nodes_first, moved_first = nodes, moved
    there = np.array([move(x) for x in nodes_first])
    same_node = [np.argmin(np.linalg.norm(nodes - x, axis=1)) for x in there]
    ends = np.array([[move(x + u) for x, u in zip(nodes_first, frame)] for frame in moved_first]) - there
    pixel = PIXEL * (MILLI if name == "m and Pa" else 1.0)
    apart = np.sqrt(((moved[:, same_node] - ends)[..., :2] ** 2).mean()) / pixel
    require(apart < (1e-3 if turned else 1e-5), f"{name}: nodes are measured where they are, {apart:.1e} px (rms)")
    if turned:
        continue
    found = {key: (one["value"], one["standard_deviation"]) for key, one in result["parameters"].items() if one["standard_deviation"]}
    first = first or found
    for key, (value, deviation) in found.items():
        unit = 1.0 if key == "delta" else variant[-1]
        off, more = abs(value / unit - first[key][0]) / first[key][1], abs(deviation / unit / first[key][1] - 1.0)
        require(max(off, more) < 1e-3, f"{name}: {key} is {value / unit:.8g} +- {deviation / unit:.3g}, off by {off:.1e} standard deviations")
end()
