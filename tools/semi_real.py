#!/usr/bin/python3
"""Semi-real tests for `imic3d loop`: the measured reference image of a dumbbell (IMIC3D_DATA/pcabs_tension) with its measured noise, warped by CalculiX's
displacement, with something in the test that the case file does not declare; and the same with nothing.

tools/semi_real.py [--only NAME,NAME] [--seed N] [--out FOLDER] [--imic3d PROGRAM]

CalculiX pulls a longer part of the dumbbell (quadratic bricks, a finer mesh; a thin sheet of steel). Each frame is the mean of the three frames at rest, blurred by 0.8 px, interpolated by splines of degree five
(imic3d's are cubic); its noise is what a measured frame at rest has beside that mean, in units of what it is at its grey level, shifted and turned over at random; it is rounded to 8 bits. Beyond the specimen a rim
of the background moves with it, the rest stands still. Writes FOLDER/trials.csv, FOLDER/table.md and a folder for each test; a test whose result is there is
not run again. Exit status: 1 where an effect is not found or nothing is taken for something, 77 without the data or CalculiX."""

import argparse
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

import blind
import calculix as cx
from calculix_virtual import backward

ROOT = Path(__file__).resolve().parents[1]
PIXEL, THICKNESS, LOAD_NOISE, REST = 0.03929, 0.5, 2.0, 4  # [mm/px], [mm], [N], frames at rest
ELONGATION = [0.012, 0.024, 0.036, 0.048, 0.06, 0.075, 0.095, 0.12, 0.15, 0.18, 0.21, 0.25, 0.3, 0.36]  # of the part between CalculiX's ends [mm]
PART, WINDOW = 44.0, (840, 470)  # length that CalculiX pulls [mm]; cut out of the image, columns and rows [px]
BLUR = 0.8  # of what is warped [px]: the noise that is left in the mean of three frames would move with the specimen as if it were paint
LAW = cx.Law()
TRUTH = dict(E=LAW.E, S_y=LAW.S_y, H=LAW.H, delta=LAW.delta)

# name in the library: (what the generator does, parameter of the size in the result, true size)
EFFECTS = {
    "magnification drift": (dict(magnification_drift=1e-3), "magnification_drift", 1e-3),
    "force gain": (dict(force_gain=1.05), "force_gain", 1.05),
    "taper": (dict(taper=0.06), "taper_x", 0.06 / 28.0),  # over the declared 28 mm
    "power_term": (dict(declared="linear"), None, None),
}


def mesh(script, output, form, order=1, **sizes):
    numbers = [a for key, value in sizes.items() for a in ("-setnumber", key, str(value))]
    more = ["-order", "2", "-string", "Mesh.SecondOrderIncomplete=1;Mesh.SaveGroupsOfNodes=1;"] if order == 2 else []
    subprocess.run(["gmsh", "-2", "-v", "1", *numbers, *more, "-format", form, ROOT / f"tools/meshes/{script}.geo", "-o", output], check=True)


def dumbbell(folder):
    """Quadratic quadrilaterals of the dumbbell: nodes (n, 2) and cells (m, 8), corners first."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh("dumbbell", folder / "fine.inp", "inp", 2, region=PART, size=1.0)
    nodes, cells, section = {}, [], ""
    for line in open(folder / "fine.inp"):
        if line.startswith("*"):
            section = line.upper()
        elif section.startswith("*NODE"):
            number, x, y, _ = line.split(",")
            nodes[int(number)] = (float(x), float(y))
        elif section.startswith("*ELEMENT") and re.search(r"TYPE=(CPS8|S8)", section):
            cells.append([int(a) for a in line.split(",")[1:]])
    numbers = sorted({n for cell in cells for n in cell})
    place = {n: i for i, n in enumerate(numbers)}
    return np.array([nodes[n] for n in numbers]), np.array([[place[n] for n in cell] for cell in cells])


def pulled(folder, taper=0.0):
    """Front face of half the thickness, pulled between clamped ends: nodes (n, 2), cells (m, 8), displacement (frames, n, 3), force (frames)."""
    flat, cells = dumbbell(folder)
    depth = 0.5 * THICKNESS * (1.0 + taper * flat[:, 0] / (2 * 14.0))  # the taper is that over the declared 28 mm
    at = lambda part: np.column_stack([flat, part * depth])
    n = len(flat)
    nodes = np.concatenate([at(0.0), at(1.0), at(0.5)])
    bricks = np.hstack([cells[:, :4], cells[:, :4] + n, cells[:, 4:], cells[:, 4:] + n, cells[:, :4] + 2 * n])
    a, b, c = (flat[cells[:, k]] for k in range(3))
    if np.any(np.cross(b - a, c - b) < 0):
        sys.exit(f"{folder}: cells that run clockwise")
    used = np.unique(bricks)
    number = np.full(len(nodes), -1)
    number[used] = np.arange(len(used))
    x, z = nodes[used, 0], nodes[used, 2]
    half = 0.5 * PART
    sets = {"FRONT": number[n:2 * n] + 1, "LEFT": cx.where(x < -half + 1e-6), "RIGHT": cx.where(x > half - 1e-6), "MZ": cx.where(z < 1e-9)}
    deck = [cx.mesh_cards(nodes[used], number[bricks]), *(cx.set_cards("NSET", *one) for one in sets.items()), cx.material_cards(LAW, "hencky"),
            "*BOUNDARY\nMZ, 3, 3\nLEFT, 2, 2\nRIGHT, 2, 2\n"]
    output = "*NODE PRINT, NSET=FRONT, FREQUENCY=1000\nU\n*NODE PRINT, NSET=RIGHT, TOTALS=ONLY, FREQUENCY=1000\nRF\n"
    before = 0.0
    for value in ELONGATION:
        deck.append(cx.step_cards(f"*BOUNDARY\nLEFT, 1, 1, {-value / 2:.12g}\nRIGHT, 1, 1, {value / 2:.12g}\n", output, max(2, int(np.ceil((value - before) / 0.04)))))
        before = value
    table, _ = cx.run("".join(deck), folder)
    rows = table["displacements", "FRONT"]
    moved = np.zeros((len(ELONGATION), len(used) + 1, 3))
    moved[:, rows[0, :, 0].astype(int)] = rows[:, :, 1:]
    return flat, cells, moved[:, sets["FRONT"]], 2.0 * table["total force", "RIGHT"][:, 0, 0]


class Photograph:
    """The measured images at rest: their mean, what each has beside it, and where the specimen is."""

    def __init__(self, data):
        images = [np.asarray(Image.open(data / f"images/frame_{k:03}.png"), float) for k in range(3)]
        self.mean = np.mean(images, 0)
        # Variance of the noise over grey level, a straight line (Poisson and Gauss); the noise in its units.
        beside = [np.sqrt(1.5) * (image - self.mean) for image in images]
        levels = np.arange(20, 221, 10)
        near = [np.abs(self.mean - level) < 5 for level in levels]
        self.variance = np.polyfit(levels, [np.mean([np.var(b[k]) for b in beside]) for k in near], 1)
        self.noise = [b / self.deviation(self.mean) for b in beside]
        columns, edges = np.arange(200, 901, 4), []
        paint = ndimage.gaussian_filter(self.mean, 2.0) > 100.0
        for column in columns:
            rows = np.flatnonzero(paint[:, column])
            edges.append((rows[0], rows[-1]))
        edges = np.array(edges, float)
        width, middle = np.ptp(edges, axis=1), edges.mean(1)
        # The waist is where the widths on either side are alike; the axis is a straight line.
        shifts = np.arange(500, 601, 0.5)
        unlike = [np.mean(np.abs(np.interp(2 * s - columns, columns, width, np.nan, np.nan) - width)[np.abs(columns - s) < 300]) for s in shifts]
        self.column = float(shifts[np.nanargmin(unlike)])
        slope, self.row = np.polyfit(columns - self.column, middle, 1)
        self.turn = np.arctan(slope)
        self.spline = ndimage.spline_filter(ndimage.gaussian_filter(self.mean, BLUR), 5)

    def deviation(self, grey):
        return np.sqrt(np.maximum(1.0, np.polyval(self.variance, grey)))

    def grey(self, nodes, cells, moved):
        """The window with the specimen's `nodes` [mm, as in the image, from the middle] displaced to `moved`."""
        wide, high = WINDOW
        columns, rows = np.arange(wide) - (wide - 1) / 2, np.arange(high) - (high - 1) / 2
        x, y = np.meshgrid(columns * PIXEL, rows * PIXEL)
        was = backward(nodes, cells, moved, columns * PIXEL, rows * PIXEL, 1)
        off = ~np.isfinite(was[0])
        distance, nearest = ndimage.distance_transform_edt(off, return_indices=True)
        shift = [(was[k] - now)[tuple(nearest)] * (distance < 12) for k, now in enumerate((x, y))]
        at = [(y + shift[1]) / PIXEL + self.row, (x + shift[0]) / PIXEL + self.column]
        return ndimage.map_coordinates(self.spline, at, order=5, prefilter=False, mode="nearest")

    def with_noise(self, grey, random):
        field = self.noise[random.integers(3)][::random.choice([-1, 1]), ::random.choice([-1, 1])] * random.choice([-1.0, 1.0])
        j, i = (random.integers(field.shape[k] - grey.shape[k] + 1) for k in (0, 1))
        return np.clip(np.rint(grey + self.deviation(grey) * field[j:j + grey.shape[0], i:i + grey.shape[1]]), 0, 255).astype(np.uint8)


def make(folder, photograph, planted, seed):
    p = dict(magnification_drift=0.0, force_gain=1.0, taper=0.0, declared="power") | planted
    random = np.random.default_rng(seed)
    flat, cells, u, force = pulled(folder.parent / f"calculix_{p['taper']:g}", p["taper"])
    turned = lambda v: v[..., :2] @ np.array([[np.cos(photograph.turn), np.sin(photograph.turn)], [-np.sin(photograph.turn), np.cos(photograph.turn)]])
    nodes = turned(flat)
    shutil.rmtree(folder / "images", ignore_errors=True)
    (folder / "images").mkdir(parents=True)
    rest = photograph.grey(nodes, cells, nodes)
    rows = ["frame,time,force"]
    for frame in range(REST + len(u)):
        clock, grey, f = 0, rest, 0.0
        if frame >= REST:
            t = frame - REST
            clock, f = t + 1, force[t]
            grey = photograph.grey(nodes, cells, (nodes + turned(u[t])) * (1.0 + p["magnification_drift"] * clock / len(u)))
        Image.fromarray(photograph.with_noise(grey, random)).save(folder / f"images/frame_{frame:03}.png")
        rows.append(f"{frame},{clock},{p['force_gain'] * f + random.normal() * LOAD_NOISE:.3f}")
    (folder / "loads.csv").write_text("\n".join(rows) + "\n")
    mesh("dumbbell", folder / "dumbbell.msh", "msh41", region=28, size=1.5)
    hardening, parameters, free = {"power": ("power_linear, tie_initial_modulus: true", "S_y: 278, H: 1420, delta: 0.042", "E, S_y, H, delta"), "linear": ("linear", "S_y: 400, H: 1400", "E, S_y, H")}[p["declared"]]
    (folder / "case.yaml").write_text(f"""title: Semi-real dumbbell
specimen: {{mesh: dumbbell.msh, kinematics: plane_stress, element: quad8, thickness: {THICKNESS}, held: left, loaded: right, axis: x}}
cameras: [{{name: front, pixel_size: {PIXEL}, place: {{origin: [{(WINDOW[0] - 1) / 2}, {(WINDOW[1] - 1) / 2}], rotation: {-np.degrees(photograph.turn):.5f}}}, images: "images/*.png", reference: 0-{REST - 1}}}]
loads: {{file: loads.csv, image: frame, time: time, force: force, noise: {LOAD_NOISE}}}
material: {{law: j2, hardening: {hardening}, parameters: {{E: 195e3, nu: {LAW.nu}, {parameters}}}}}
identify: {{functional: displacement_driven, stages: [{{free: [{free}]}}]}}
loop: {{draws: 60, additions: 1, starts: [1.0], {"rivals: 3, prior: {E: 2000}" if p["force_gain"] != 1.0 else "rivals: 2"}}}
output: run
""")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="of: nothing, " + ", ".join(EFFECTS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/semi_real"))
    parser.add_argument("--imic3d", default="build/release/imic3d")
    options = parser.parse_args()
    data = Path(os.environ.get("IMIC3D_DATA", ROOT.parent / "shared/data")) / "pcabs_tension"
    for missing, what in ((not (data / "images").is_dir(), "no pcabs_tension in IMIC3D_DATA"), (shutil.which("ccx") is None, "CalculiX (ccx) is not installed")):
        if missing:
            print("SKIPPED:", what)
            sys.exit(77)
    photograph = Photograph(data)
    print(f"the specimen's middle at column {photograph.column:.1f}, row {photograph.row:.1f}, turned by {np.degrees(photograph.turn):.2f} degrees; noise {photograph.deviation(60.0):.2f} to {photograph.deviation(200.0):.2f} grey levels", flush=True)
    suite = blind.Suite(options.out, options.imic3d, lambda folder, planted, seed: make(folder, photograph, planted, seed), TRUTH)
    only = set(filter(None, options.only.split(",")))
    lines = ["| planted | verdict | size found (true) | χ (null) | held-out χ (null) | worst parameter |", "|---|---|---|---|---|---|"]
    for name, (planted, parameter, size) in ({"nothing": ({}, None, None)} | EFFECTS).items():
        if only and name not in only:
            continue
        result = suite.trial("null" if name == "nothing" else "effect", name, "-", planted, options.seed)
        if result is None:
            continue
        before, after = result["before"]["chi"], result["after"]["chi"]
        found = result["after"]["parameters"].get(parameter) if parameter else None
        said = f"{found['value']:.4g} ± {found['standard_deviation']:.2g} ({size:g})" if found else ""
        arrow = lambda key: f"{before[key]:.2f}" + (f" → {after[key]:.2f}" if result["named"] else "") + f" ({after['null_' + key]:.2f})"
        bias = suite.bias(result["before"]), suite.bias(result["after"])
        lines.append(f"| {name} | {result['verdict']}: {', '.join(result['set'] or result['named']) or '–'} | {said} | {arrow('fitted')} | {arrow('held_out')} | {100 * bias[0]:.2f}" + (f" → {100 * bias[1]:.2f}" if result["named"] else "") + " % |")
    suite.report()
    (options.out / "table.md").write_text("\n".join(lines) + "\n")
    print("\n" + "\n".join(lines))
    suite.fail_unless_right(0)


if __name__ == "__main__":
    main()
