#!/usr/bin/python3
"""Displacement gradient of the tensile bar `pcabs_tension` at frame 8: this program's DIC against the laboratory's own.

Reads pcabs_tension.csv (written by test_correlation, Measured.TensileBarFieldIsWrittenForComparison) and the laboratory's
step_000.npz and step_008.npz; prints the rms difference of each gradient component and the noise expected, and draws a map.
Both displacement fields are taken at the laboratory's points (every 5 px) and differentiated in the same way: least squares
of an affine field in square windows.
"""
import argparse
import csv
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

COMPONENTS = ("du_x/dx", "du_x/dy", "du_y/dx", "du_y/dy")


def read_nodes(file):
    """{frame: (xs [nx], ys [ny], u [ny, nx, 2], deviation [ny, nx, 2])} of a structured mesh, in pixels."""
    frames = {}
    with open(file) as stream:
        for row in csv.DictReader(stream):
            frames.setdefault(int(row["frame"]), []).append([float(value) for value in list(row.values())[1:]])
    result = {}
    for frame, rows in frames.items():
        rows = np.array(rows)
        xs, ys = np.unique(rows[:, 0]), np.unique(rows[:, 1])
        grid = rows[np.lexsort((rows[:, 0], rows[:, 1]))].reshape(len(ys), len(xs), 6)
        result[frame] = xs, ys, grid[..., 2:4], grid[..., 4:6]
    return result


def interpolated(xs, ys, u, x, y):
    """Bilinear interpolation of the nodal field at points (x, y) [n]; NaN outside."""
    inside = (x >= xs[0]) & (x <= xs[-1]) & (y >= ys[0]) & (y <= ys[-1])
    i = np.clip(np.searchsorted(xs, x) - 1, 0, len(xs) - 2)
    j = np.clip(np.searchsorted(ys, y) - 1, 0, len(ys) - 2)
    s, t = ((x - xs[i]) / (xs[i + 1] - xs[i]))[:, None], ((y - ys[j]) / (ys[j + 1] - ys[j]))[:, None]
    value = (1 - t) * ((1 - s) * u[j, i] + s * u[j, i + 1]) + t * ((1 - s) * u[j + 1, i] + s * u[j + 1, i + 1])
    return np.where(inside[:, None], value, np.nan)


def window_gradients(x, y, u, centres, half):
    """Gradient [centres, 4] (COMPONENTS) of u [n, 2] by an affine fit in windows of +-half px."""
    result = np.full((len(centres), 4), np.nan)
    valid = np.isfinite(u).all(1)
    for k, (cx, cy) in enumerate(centres):
        near = valid & (np.abs(x - cx) <= half) & (np.abs(y - cy) <= half)
        if near.sum() < 10:
            continue
        places = np.column_stack([np.ones(near.sum()), x[near] - cx, y[near] - cy])
        coefficients = np.linalg.lstsq(places, u[near], rcond=None)[0]
        result[k] = coefficients[1, 0], coefficients[2, 0], coefficients[1, 1], coefficients[2, 1]
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("csv", type=Path, help="pcabs_tension.csv")
    parser.add_argument("reference", type=Path, help="folder reference_dic of the data set")
    parser.add_argument("--window", type=float, default=80.0, help="side of the windows [px]")
    parser.add_argument("--picture", type=Path, default=Path("pcabs_tension.png"))
    arguments = parser.parse_args()

    nodes = read_nodes(arguments.csv)
    before, after = (np.load(arguments.reference / f"step_{frame:03d}.npz") for frame in (0, 8))
    valid = (before["mask"] > 0) & (after["mask"] > 0)
    x, y = before["pixpos_x"][valid].astype(float), before["pixpos_y"][valid].astype(float)
    theirs = np.column_stack([after["pixpos_x"][valid] - x, after["pixpos_y"][valid] - y])
    xs, ys, u, deviation = nodes[8]
    ours = interpolated(xs, ys, u, x, y)
    common = np.isfinite(ours).all(1)
    x, y, theirs, ours = x[common], y[common], theirs[common], ours[common]

    half = 0.5 * arguments.window
    centres = [(a, b) for b in np.arange(ys[0] + half, ys[-1] - half + 1, half / 2)
               for a in np.arange(xs[0] + half, xs[-1] - half + 1, half / 2)]
    gradient_ours = window_gradients(x, y, ours, centres, half)
    gradient_theirs = window_gradients(x, y, theirs, centres, half)
    difference = gradient_ours - gradient_theirs
    # Frames 1 and 2 show the unloaded bar: what is measured there is noise.
    still = np.concatenate([
        window_gradients(x, y, interpolated(nodes[k][0], nodes[k][1], nodes[k][2], x, y), centres, half) for k in (1, 2)
    ])
    mean = difference.mean(0)

    print(f"{common.sum()} points of the laboratory inside the mesh, windows of {arguments.window:.0f} px, {len(centres)} centres")
    gap = ours - theirs
    print(f"displacement: mean difference {gap.mean(0).round(4)} px, standard deviation {gap.std(0).round(4)} px")
    print(f"mean of the nodes' predicted standard deviation: {deviation.mean((0, 1)).round(4)} px")
    print("component    mean ours    mean theirs  rms difference  of which mean  noise of ours (static frames)")
    for k, name in enumerate(COMPONENTS):
        print(f"{name:10s} {gradient_ours[:, k].mean():12.3e} {gradient_theirs[:, k].mean():12.3e} "
              f"{np.sqrt((difference[:, k] ** 2).mean()):13.3e} {mean[k]:16.3e} {np.sqrt((still[:, k] ** 2).mean()):16.3e}")

    figure, axes = plt.subplots(4, 3, figsize=(13, 10), constrained_layout=True)
    shape = (len({c[1] for c in centres}), len({c[0] for c in centres}))
    extent = (centres[0][0], centres[-1][0], centres[-1][1], centres[0][1])
    for k, name in enumerate(COMPONENTS):
        limits = np.nanpercentile(np.concatenate([gradient_ours[:, k], gradient_theirs[:, k]]), (1, 99)) * 1e3
        for column, (title, field) in enumerate((("imic3d", gradient_ours), ("laboratory", gradient_theirs),
                                                 ("difference", difference))):
            low, high = limits if column < 2 else np.array([-0.5, 0.5]) * (limits[1] - limits[0])
            picture = axes[k, column].imshow(field[:, k].reshape(shape) * 1e3, extent=extent, vmin=low, vmax=high)
            axes[k, column].set_title(f"{name}, {title} [1e-3]", fontsize=9)
            figure.colorbar(picture, ax=axes[k, column])
    figure.suptitle(f"pcabs_tension, frame 8 against 0; affine fits in windows of {arguments.window:.0f} px")
    figure.savefig(arguments.picture, dpi=110)


if __name__ == "__main__":
    main()
