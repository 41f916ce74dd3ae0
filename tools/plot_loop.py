#!/usr/bin/python3
"""Figures of a run of imic3d loop as PNG files, from its results.h5.

Usage: tools/plot_loop.py results.h5 [--folder FOLDER] [--frame NUMBER]

Makes chi.png (error of each frame before and after with the null, the load below), force.png (measured - predicted; where there is a load record), residual.png (displacement
measured - predicted before and after on one scale) and remainder.png (what is left over its rms under the null, and its first mode); cameras on both faces: residual_front.png
and so on. Of stress-strain curves chi.png and curves.png (a row for each group: measured and predicted, and what is left); of several tests chi.png, and the figures of each test in
its own folder. Held-out frames are shaded, held-out curves grey; the frame that is drawn is the worst one of the declared model, if none is chosen."""
import argparse
import pathlib

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import matplotlib.tri
import numpy

BEFORE, AFTER, NULL = "#b2182b", "#1f5fa8", "#888888"


def unit(dataset):
    value = dataset.attrs["unit"]
    return value.decode() if isinstance(value, bytes) else str(value)


def shade(axis, frames, held):
    for frame in frames[held]:
        axis.axvspan(frame - 0.5, frame + 0.5, color="#dddddd", lw=0)


def field(figure, axis, h5, values, title, **scale):
    nodes, cells = h5["surface/nodes"][:], h5["surface/cells"][:]
    triangles = matplotlib.tri.Triangulation(nodes[:, 0], nodes[:, 1], numpy.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]]))
    picture = axis.tripcolor(triangles, values, shading="gouraud", **scale)
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=9)
    figure.colorbar(picture, ax=axis)


def texts(dataset):
    return [text.decode() if isinstance(text, bytes) else str(text) for text in dataset[()]]


def draw_chi(folder, loop, frames, held):
    load = next((name for name in ("force", "time") if name in loop), None)
    figure, axes = plt.subplots(2 if load else 1, 1, figsize=(8, 6 if load else 4.5), sharex=True, squeeze=False, gridspec_kw={"height_ratios": (3, 1)} if load else None)
    top = axes[0, 0]
    for axis in axes[:, 0]:
        shade(axis, frames, held)
    for name, colour in (("before", BEFORE), ("after", AFTER)):
        top.plot(frames, loop[f"{name}/chi"][:], "o-", ms=3, color=colour, label=name)
    top.plot(frames, loop["after/null_chi"][:], color=NULL, label="noise alone, 95 %")
    top.set_yscale("log")
    top.set_ylabel("χ")
    top.legend()
    for name, first in zip(texts(loop["tests"]), loop["first_frames"][:]) if "tests" in loop else ():
        top.axvline(first - 0.5, color="#222222", lw=0.8)
        top.annotate(name, (first - 0.3, 0.02), xycoords=("data", "axes fraction"), fontsize=8)
    if load:
        axes[1, 0].plot(frames, loop[load][:], color="#222222")
        axes[1, 0].set_ylabel(f"{load} [{unit(loop[load])}]")
    axes[-1, 0].set_xlabel("frame")
    figure.savefig(folder / "chi.png", dpi=110)


def draw_force(folder, loop, frames, held):
    figure, axis = plt.subplots(figsize=(8, 4))
    shade(axis, frames, held)
    for name, colour in (("before", BEFORE), ("after", AFTER)):
        axis.plot(frames, loop[f"{name}/force"][:], "o-", ms=3, color=colour, label=name)
    axis.set_xlabel("frame")
    axis.set_ylabel(f"force, measured − predicted [{unit(loop['force'])}]")
    axis.legend()
    figure.savefig(folder / "force.png", dpi=110)


def draw_curves(folder, curves):
    groups, held = texts(curves["groups"]), curves["held_out"][:].astype(bool)
    rows = list(dict.fromkeys(groups))
    figure, axes = plt.subplots(len(rows), 2, figsize=(13, 3.4 * len(rows)), squeeze=False, constrained_layout=True)
    for k, group in enumerate(groups):
        one, (left, right) = curves[f"{k:04d}"], axes[rows.index(group)]
        strain, measured = one["strain"][:], one["measured"][:]
        first = groups.index(group) == k
        left.plot(strain, measured, color=NULL if held[k] else "#222222", lw=0.8, label="measured" if first else None)
        for name, colour in (("before", BEFORE), ("after", AFTER)):
            left.plot(strain, one[name][:], color=colour, lw=0.8, label=name if first else None)
            right.plot(strain, measured - one[name][:], color=colour, lw=0.6, alpha=0.5 if held[k] else 1.0)
    for group, (left, right) in zip(rows, axes):
        left.set(title=group, xlabel="logarithmic strain", ylabel=f"stress [{unit(curves['0000/measured'])}]")
        right.set(title="measured − predicted", xlabel="logarithmic strain")
        right.axhline(0, color="k", lw=0.5)
        left.legend(fontsize=7)
    figure.savefig(folder / "curves.png", dpi=90)


def draw_face(folder, h5, loop, name_of_face, frames, worst):
    """Displacement and remainder of a face, whose group `h5` is; `loop` is what all have in common."""
    own = h5["loop"]
    both = [own[f"{name}/displacement"][worst] for name in ("before", "after")]
    seen = 3 if numpy.any(own["before/displacement"][:, :, 2]) else 2
    both = [values[:, :seen] for values in both]
    largest = max(numpy.abs(both[0]).max(), 1e-300)
    figure, axes = plt.subplots(2, seen, figsize=(4.5 * seen, 9), constrained_layout=True)
    for row, (name, values) in enumerate(zip(("before", "after"), both)):
        for k, component in enumerate("xyz"[:seen]):
            field(figure, axes[row, k], h5, values[:, k], f"{name}: u_{component}, frame {frames[worst]} [{unit(own['before/displacement'])}]", cmap="RdBu", vmin=-largest, vmax=largest)
    figure.savefig(folder / f"residual{name_of_face}.png", dpi=110)

    if "remainder" not in own:
        return
    of_map = own["remainder/map"][:]
    last = int(numpy.argmax(of_map.max(axis=1)))
    figure, axes = plt.subplots(1, 3, figsize=(14, 5), constrained_layout=True)
    field(figure, axes[0], h5, of_map[last], f"remainder over the noise, frame {frames[last]}", cmap="magma", vmin=0)
    field(figure, axes[1], h5, numpy.linalg.norm(own["remainder/mode"][:], axis=1), f"first mode [{unit(own['remainder/mode'])}]", cmap="magma", vmin=0)
    axes[2].plot(frames, loop["remainder/time"][:], "o-", ms=3, color=AFTER)
    axes[2].set_xlabel("frame")
    axes[2].set_title("first mode over the frames [noise]", fontsize=9)
    figure.savefig(folder / f"remainder{name_of_face}.png", dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=pathlib.Path)
    parser.add_argument("--folder", type=pathlib.Path)
    parser.add_argument("--frame", type=int)
    options = parser.parse_args()
    draw(options.results, options.folder or options.results.parent, options.frame)


def draw(results, folder, frame=None):
    folder.mkdir(parents=True, exist_ok=True)
    with h5py.File(results) as h5:
        if "loop" not in h5:
            raise SystemExit(f"{results}: no loop in it (tools/plot_results.py draws an identification)")
        loop = h5["loop"]
        frames, held = loop["frames"][:], loop["held_out"][:].astype(bool)
        draw_chi(folder, loop, frames, held)
        if "force" in loop:
            draw_force(folder, loop, frames, held)
        if "curves" in h5:
            draw_curves(folder, h5["curves"])
        worst = int(numpy.argmax(loop["before/chi"][:])) if frame is None else int(numpy.flatnonzero(frames == frame)[0])
        for name, face in (("", h5), ("_front", h5.get("front")), ("_back", h5.get("back"))):
            if face is not None and "surface" in face:
                draw_face(folder, face, loop, name, frames, worst)
        tests = texts(loop["tests"]) if "tests" in loop else []
    for test in tests:
        draw(results.parent / test / "results.h5", folder / test)
    plt.close("all")


if __name__ == "__main__":
    main()
