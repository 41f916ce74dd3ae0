#!/usr/bin/env python3
"""A virtual test that owes nothing to imic3d: CalculiX pulls the plate with a hole, a separate maker draws its images.

CalculiX: 60 mm between clamped grips, quadratic bricks, one eighth by symmetry. The images are drawn, none is
interpolated: the speckle is a product of discs with smooth edges, given by formulas in the undeformed plate; every
sample of every pixel is mapped back on the undeformed plate by Newton's method in the quadratic element that it lies
in; the samples of a pixel are averaged; noise is added and the grey level rounded to 8 bits.

Writes in the output folder: images/frame_NNN.png (or .tif), loads.csv, truth.json, mesh.msh (coarse quadrilaterals on
the 20 x 24 mm around the hole, groups top, bottom, hole, sides), and displacement.npz: `nodes` (n, 2) mm, `faces`
(m, 8) (corners, then middles), `displacement` (frames, n, 3) mm of the front face, one for every image.

Frames 0, 1, 2 are static; 2 is the reference. The camera is telecentric and follows the specimen's mean motion. The
point (x, y) mm of the plate is at column (width - 1) / 2 + x / pixel, row (height - 1) / 2 - y / pixel, counted from
the centre of the first pixel: y is up in the image.
"""

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

import calculix as cx

STATIC = 3
PAINT, DISC, BACKGROUND = 0.80, 0.16, 0.06  # grey of the paint, of a disc and of what is behind, as shares of 255


# --- the test ---

def strains(options):
    """Mean strain of each frame."""
    known = cx.FRAMES_PERCENT[cx.FRAMES_PERCENT <= options.strain + 1e-9] / 100.0
    return np.interp(np.linspace(0, len(known) - 1, options.frames), np.arange(len(known)), known)


def simulate(options, law, folder, plate=None):
    """Front face of the whole plate: nodes (n, 2), faces (m, 8), displacement (frames, n, 3); force (frames)."""
    plate = plate or cx.Plate(length=options.length, around=options.density, outward=options.density,
                              along=max(2, options.density // 2), through=max(2, options.density // 3))
    to = strains(options)
    deck, nodes, cells, _ = cx.plate_deck(plate, law, to, True, options.theory, options.increment / 100.0,
                                          front=True)
    table, seconds = cx.run(deck, folder, "virtual")
    print(f"ccx: {len(cells)} elements, {options.frames} frames, {seconds:.0f} s", flush=True)
    force = 4.0 * table["total force", "END"][:, 0, 1]
    rows = table["displacements", "FRONT"]
    quarter = np.zeros((len(to), len(nodes), 3))
    quarter[:, rows[0, :, 0].astype(int) - 1] = rows[:, :, 1:]

    top = cells[:, [4, 5, 6, 7, 12, 13, 14, 15]]  # the face at z = +t/2 of a C3D20
    top = top[np.all(nodes[top, 2] > plate.thickness / 2.0 - 1e-6, axis=1)]
    points, faces, moved = [], [], []
    for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        turned = top if sx * sy > 0 else top[:, [0, 3, 2, 1, 7, 6, 5, 4]]  # a mirror reverses the order
        faces.append(turned + len(nodes) * len(points))
        points.append(nodes[:, :2] * [sx, sy])
        moved.append(quarter * [sx, sy, 1])
    points, moved = np.concatenate(points), np.concatenate(moved, axis=1)
    faces = np.concatenate(faces)
    used = np.unique(faces)
    _, first, inverse = np.unique(np.round(points[used], 7) + 0.0, axis=0, return_index=True, return_inverse=True)
    renumber = np.zeros(len(points), int)
    renumber[used] = inverse.ravel()
    still = np.zeros((STATIC, len(first), 3))
    return (points[used][first], renumber[faces], np.concatenate([still, moved[:, used][:, first]]),
            np.concatenate([np.zeros(STATIC), force]))


# --- the map of a quadratic face and its inverse ---

def shape(xi, eta):
    """Eight serendipity functions and their two derivatives, each (8, ...): corners counter-clockwise, then middles."""
    a, b, c, d = 1 - xi, 1 + xi, 1 - eta, 1 + eta
    p, q = a * b, c * d
    N = [a * c * (-xi - eta - 1) / 4, b * c * (xi - eta - 1) / 4,
         b * d * (xi + eta - 1) / 4, a * d * (-xi + eta - 1) / 4, p * c / 2, b * q / 2, p * d / 2, a * q / 2]
    dx = [c * (2 * xi + eta) / 4, c * (2 * xi - eta) / 4, d * (2 * xi + eta) / 4, d * (2 * xi - eta) / 4,
          -xi * c, q / 2, -xi * d, -q / 2]
    dy = [a * (2 * eta + xi) / 4, b * (2 * eta - xi) / 4, b * (2 * eta + xi) / 4, a * (2 * eta - xi) / 4,
          -p / 2, -eta * b, p / 2, -eta * a]
    return N, dx, dy


def combine(functions, values):
    """Sum of function times nodal value."""
    total = functions[0] * values[0]
    for function, value in zip(functions[1:], values[1:]):
        total += function * value
    return total


def newton(corners, x, y, xi, eta, iterations):
    """(xi, eta) that the face with nodes `corners` (8, 2) maps on (x, y), from a first guess, kept within a box."""
    for _ in range(iterations):
        N, dx, dy = shape(xi, eta)
        rx, ry = x - combine(N, corners[:, 0]), y - combine(N, corners[:, 1])
        xa, ya, xb, yb = (combine(d, corners[:, k]) for d in (dx, dy) for k in (0, 1))
        det = xa * yb - xb * ya
        det = np.where(np.abs(det) > 1e-12, det, 1e-12)
        xi = np.clip(xi + (yb * rx - xb * ry) / det, -3, 3)
        eta = np.clip(eta + (xa * ry - ya * rx) / det, -3, 3)
    return xi, eta


def backward(nodes, faces, moved, columns, rows, samples):
    """Undeformed position (X, Y) of every sample; `columns`, `rows`: the samples' current x and y [mm, ascending].
    NaN where there is no material. Newton in each face: first at the pixels' centres, then at the samples of those
    pixels that may lie in the face."""
    X = np.full((2, len(rows), len(columns)), np.nan)
    wide, high = len(columns) // samples, len(rows) // samples
    middle_x, middle_y = columns.reshape(wide, samples).mean(1), rows.reshape(high, samples).mean(1)
    step = middle_x[1] - middle_x[0]
    blocks = X.reshape(2, high, samples, wide, samples)
    for face in faces:
        before, now = nodes[face], moved[face]
        i0, i1 = np.searchsorted(middle_x, [now[:, 0].min() - 1.5 * step, now[:, 0].max() + 1.5 * step])
        j0, j1 = np.searchsorted(middle_y, [now[:, 1].min() - 1.5 * step, now[:, 1].max() + 1.5 * step])
        if i0 == i1 or j0 == j1:
            continue
        y, x = (a.ravel() for a in np.meshgrid(middle_y[j0:j1], middle_x[i0:i1], indexing="ij"))
        row, column = (a.ravel() for a in np.meshgrid(np.arange(j0, j1), np.arange(i0, i1), indexing="ij"))
        xi, eta = newton(now, x, y, np.zeros_like(x), np.zeros_like(x), 6)
        margin = 1.0 + 6.0 * step / np.sqrt(np.prod(np.ptp(now, axis=0)))
        near = np.maximum(np.abs(xi), np.abs(eta)) < margin
        xi, eta, row, column = xi[near], eta[near], row[near], column[near]
        sub = (len(row), samples, samples)
        x = np.broadcast_to(columns.reshape(wide, samples)[column][:, None, :], sub)
        y = np.broadcast_to(rows.reshape(high, samples)[row][:, :, None], sub)
        xi, eta = newton(now, x, y, np.broadcast_to(xi[:, None, None], sub),
                         np.broadcast_to(eta[:, None, None], sub), 2)
        N, _, _ = shape(xi, eta)
        inside = np.maximum(np.abs(xi), np.abs(eta)) <= 1.0 + 1e-9
        pixel, j, i = np.nonzero(inside)
        for k in (0, 1):
            blocks[k, row[pixel], j, column[pixel], i] = combine(N, before[:, k])[inside]
    return X


def residual_in_pixels(nodes, faces, moved, X, columns, rows, pixel, seed=0):
    """Largest distance [px] between where a sample is and where its undeformed position goes, the other way round: the
    face is searched in the undeformed plate, then displaced. 2000 samples."""
    j, i = np.nonzero(np.isfinite(X[0]))
    chosen = np.random.default_rng(seed).choice(len(i), 2000)
    j, i = j[chosen], i[chosen]
    at, there = forward(nodes, faces, moved, X[0, j, i], X[1, j, i])
    return np.max(np.hypot(at[:, 0] - columns[i], at[:, 1] - rows[j])[there]) / pixel


def forward(nodes, faces, moved, X, Y):
    """Current position of undeformed points; the second value says which lie in the plate."""
    at, there = np.full((len(X), 2), np.nan), np.zeros(len(X), bool)
    for face in faces:
        before = nodes[face]
        low, high = before.min(0) - 0.1, before.max(0) + 0.1
        k = np.flatnonzero((X > low[0]) & (X < high[0]) & (Y > low[1]) & (Y < high[1]) & ~there)
        if not len(k):
            continue
        xi, eta = newton(before, X[k], Y[k], np.zeros(len(k)), np.zeros(len(k)), 8)
        inside = np.maximum(np.abs(xi), np.abs(eta)) <= 1.0 + 1e-9
        N, _, _ = shape(xi[inside], eta[inside])
        at[k[inside]] = np.column_stack([combine(N, moved[face, 0]), combine(N, moved[face, 1])])
        there[k[inside]] = True
    return at, there


# --- the picture ---

def speckle(options, generator):
    """Discs (x, y, radius) [mm] on the undeformed plate, covering about half of it."""
    radius_px = (1.6, 3.4)
    wide, high = 20.0, 1.1 * options.height * options.pixel
    mean_area = np.pi * (radius_px[0]**2 + radius_px[0] * radius_px[1] + radius_px[1]**2) / 3.0 * options.pixel**2
    count = int(0.75 * wide * high / mean_area)
    radius = generator.uniform(*radius_px, count) * options.pixel
    return generator.uniform(-wide / 2, wide / 2, count), generator.uniform(-high / 2, high / 2, count), radius


def paint(X, columns, rows, discs, centres, stretch, edge):
    """Share of paint that no disc covers, sample by sample. A disc's edge is a cubic step, `edge` mm to each side."""
    clear = np.ones(X.shape[1:], np.float32)
    x0, y0, step = columns[0], rows[0], columns[1] - columns[0]
    for xc, yc, r, (x, y) in zip(*discs, centres):
        reach = stretch * (r + edge)
        i0, i1 = int((x - reach - x0) / step), int((x + reach - x0) / step) + 2
        j0, j1 = int((y - reach - y0) / step), int((y + reach - y0) / step) + 2
        if i1 <= 0 or j1 <= 0 or i0 >= len(columns) or j0 >= len(rows):
            continue
        window = np.s_[max(j0, 0):j1, max(i0, 0):i1]
        distance = np.sqrt((X[0][window] - xc)**2 + (X[1][window] - yc)**2)
        t = np.clip((r + edge - distance) / (2.0 * edge), 0.0, 1.0)
        clear[window] *= 1.0 - t * t * (3.0 - 2.0 * t)
    return clear


def picture(nodes, faces, moved, discs, options):
    """Grey levels (height, width) before noise and rounding, 0 to 255, top row first; and the samples' positions."""
    n, pixel = options.samples, options.pixel
    columns = (np.arange(options.width * n) + 0.5) / n - options.width / 2.0
    rows = (np.arange(options.height * n) + 0.5) / n - options.height / 2.0  # ascending y: turned over at the end
    columns, rows = columns * pixel, rows * pixel
    X = backward(nodes, faces, moved, columns, rows, n)
    centres, there = forward(nodes, faces, moved, discs[0], discs[1])
    seen = there & (np.abs(centres[:, 1]) < rows[-1] + 1.0)
    stretch = 1.05 * largest_stretch(nodes, faces, moved)
    clear = paint(X, columns, rows, [d[seen] for d in discs], centres[seen], stretch, 1.2 * pixel)
    grey = np.where(np.isfinite(X[0]), DISC + (PAINT - DISC) * clear, BACKGROUND)
    grey = 255.0 * grey.reshape(options.height, n, options.width, n).mean((1, 3))
    return grey[::-1], X, columns, rows


def largest_stretch(nodes, faces, moved):
    """Largest principal stretch over the faces' corners and middles."""
    xi, eta = np.array([-1, 1, 1, -1, 0, 1, 0, -1.]), np.array([-1, -1, 1, 1, -1, 0, 1, 0.])
    _, dx, dy = (np.array(f) for f in shape(xi, eta))
    before, now = (np.stack([np.einsum("ag,fak->fgk", d, v[faces]) for d in (dx, dy)], -1) for v in (nodes, moved))
    return np.linalg.svd(now @ np.linalg.inv(before), compute_uv=False).max()


# --- the coarse mesh for identification ---

GEO = """// quadrilaterals on the plate around its hole: {wide:g} x {high:g} mm, hole {hole:g} mm
Mesh.MshFileVersion = 2.2; Mesh.RecombineAll = 1; General.Verbosity = 2;
a = {hole:g} / 2 * Sqrt(0.5); w = {wide:g} / 2; h = {high:g} / 2; q = {wide:g} / 2;
Point(1) = {{0, 0, 0}};
Point(2) = {{a, a, 0}};   Point(3) = {{-a, a, 0}};  Point(4) = {{-a, -a, 0}}; Point(5) = {{a, -a, 0}};
Point(6) = {{w, q, 0}};   Point(7) = {{-w, q, 0}};  Point(8) = {{-w, -q, 0}}; Point(9) = {{w, -q, 0}};
Point(10) = {{w, h, 0}};  Point(11) = {{-w, h, 0}}; Point(12) = {{-w, -h, 0}}; Point(13) = {{w, -h, 0}};
Circle(1) = {{2, 1, 3}}; Circle(2) = {{3, 1, 4}}; Circle(3) = {{4, 1, 5}}; Circle(4) = {{5, 1, 2}};
Line(5) = {{6, 7}}; Line(6) = {{7, 8}}; Line(7) = {{8, 9}}; Line(8) = {{9, 6}};
Line(9) = {{2, 6}}; Line(10) = {{3, 7}}; Line(11) = {{4, 8}}; Line(12) = {{5, 9}};
Line(13) = {{6, 10}}; Line(14) = {{10, 11}}; Line(15) = {{11, 7}};
Line(16) = {{8, 12}}; Line(17) = {{12, 13}}; Line(18) = {{13, 9}};
Curve Loop(1) = {{1, 10, -5, -9}};  Plane Surface(1) = {{1}};
Curve Loop(2) = {{2, 11, -6, -10}}; Plane Surface(2) = {{2}};
Curve Loop(3) = {{3, 12, -7, -11}}; Plane Surface(3) = {{3}};
Curve Loop(4) = {{4, 9, -8, -12}};  Plane Surface(4) = {{4}};
Curve Loop(5) = {{13, 14, 15, -5}}; Plane Surface(5) = {{5}};
Curve Loop(6) = {{16, 17, 18, -7}}; Plane Surface(6) = {{6}};
Transfinite Curve {{1:8, 14, 17}} = {around} + 1;
Transfinite Curve {{9:12}} = {outward} + 1 Using Progression 1.15;
Transfinite Curve {{13, 15, 16, 18}} = {along} + 1;
Transfinite Surface {{1:6}};
Physical Curve("top") = {{14}}; Physical Curve("bottom") = {{17}}; Physical Curve("hole") = {{1:4}};
Physical Curve("sides") = {{6, 8, 13, 15, 16, 18}}; Physical Surface("specimen") = {{1:6}};
"""


def write_region_mesh(path, around=8, outward=7, along=1):
    geo = path.with_suffix(".geo")
    geo.write_text(GEO.format(wide=20.0, high=24.0, hole=5.0, around=around, outward=outward, along=along))
    subprocess.run(["gmsh", "-2", "-format", "msh2", str(geo), "-o", str(path)], check=True, stdout=subprocess.DEVNULL)
    geo.unlink()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=cx.HelpFormatter)
    parser.add_argument("output", type=Path, help="folder to write in (outside of the repository)")
    parser.add_argument("--frames", type=int, default=30,
                        help="loaded frames, after 3 static ones (default %(default)d)")
    parser.add_argument("--strain", type=float, default=6.0,
                        help="last mean strain between the grips [%%] (default %(default)g)")
    parser.add_argument("--width", type=int, default=640, help="of the image [px] (default %(default)d)")
    parser.add_argument("--height", type=int, default=800, help="of the image [px] (default %(default)d)")
    parser.add_argument("--pixel", type=float, default=0.035, help="size of a pixel [mm] (default %(default)g)")
    parser.add_argument("--samples", type=int, default=4, help="samples of a pixel along a side (default %(default)d)")
    parser.add_argument("--noise", type=float, default=1.5,
                        help="standard deviation [grey levels] (default %(default)g)")
    parser.add_argument("--force-noise", type=float, default=20.0, help="standard deviation [N] (default %(default)g)")
    parser.add_argument("--seed", type=int, default=1, help="of speckle and noise (default %(default)d)")
    parser.add_argument("--format", choices=("png", "tif"), default="png", help="of the images (default %(default)s)")
    parser.add_argument("--length", type=float, default=60.0, help="between the grips [mm] (default %(default)g)")
    parser.add_argument("--density", type=int, default=6,
                        help="CalculiX elements on 45 degrees of the hole (default %(default)d)")
    parser.add_argument("--increment", type=float, default=0.15,
                        help="largest increment [%% mean strain] (default %(default)g)")
    parser.add_argument("--theory", choices=("hencky", "simo"), default="hencky", help="see calculix_plate.py "
                        "(default %(default)s)")
    cx.add_law_options(parser)
    options = parser.parse_args()
    law, generator, start = cx.law_of(options), np.random.default_rng(options.seed), time.time()
    images = options.output / "images"
    images.mkdir(parents=True, exist_ok=True)

    nodes, faces, displacement, force = simulate(options, law, tempfile.mkdtemp(prefix="calculix_"))
    np.savez_compressed(options.output / "displacement.npz", nodes=nodes, faces=faces, displacement=displacement)
    write_region_mesh(options.output / "mesh.msh")
    discs, still, worst = speckle(options, generator), None, 0.0
    for frame, u in enumerate(displacement):
        if frame >= STATIC or still is None:
            moved = nodes + u[:, :2]
            still, X, columns, rows = picture(nodes, faces, moved, discs, options)
            worst = max(worst, residual_in_pixels(nodes, faces, moved, X, columns, rows, options.pixel))
        noisy = still + generator.normal(0.0, options.noise, still.shape)
        grey = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        Image.fromarray(grey).save(images / f"frame_{frame:03d}.{options.format}")
    print(f"{len(displacement)} images, back and forth within {worst:.1e} px, {time.time() - start:.0f} s in all")

    recorded = force + generator.normal(0.0, options.force_noise, force.shape)
    seconds = np.maximum(np.arange(len(force)) - (STATIC - 1), 0)
    (options.output / "loads.csv").write_text("frame,time_s,force_N\n" + "".join(
        f"{n},{t:.3f},{f:.2f}\n" for n, (t, f) in enumerate(zip(seconds, recorded))))
    truth = {"E": law.E, "nu": law.nu, "S_y": law.S_y, "H": law.H, "delta": law.delta, "noise_gl": options.noise,
             "force_sd": options.force_noise, "reference": "frame_002", "pixel_mm": options.pixel,
             "column_of_x0": (options.width - 1) / 2, "row_of_y0": (options.height - 1) / 2, "theory": options.theory,
             "force_N_exact": [round(float(f), 3) for f in force],
             "units": {"E": "MPa", "S_y": "MPa", "H": "MPa", "noise_gl": "grey levels", "force_sd": "N"},
             "note": "Eq. 18 tied by Eq. 19; nothing undeclared; made by tools/calculix_virtual.py"}
    (options.output / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


if __name__ == "__main__":
    main()
