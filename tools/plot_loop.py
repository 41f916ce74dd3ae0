#!/usr/bin/python3
"""Figures of a run of imic3d loop as PNG files, from its results.h5.

Usage: tools/plot_loop.py results.h5 [--folder FOLDER] [--frame NUMBER]

Makes chi.png (error of each frame before and after with the null, the load below), force.png (measured - predicted; where there is a load record), residual.png (displacement
measured - predicted before and after on one scale) and remainder.png (what is left over its rms under the null, and its first mode); cameras on both faces: residual_front.png
and so on. Held-out frames are shaded; the frame that is drawn is the worst one of the declared model, if none is chosen."""
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


def draw_face(folder, h5, loop, name_of_face, frames, worst):
    """Displacement and remainder of a face, whose group `h5` is; `loop` is what all have in common."""
    own = h5["loop"]
    both = [own[f"{name}/displacement"][worst] for name in ("before", "after")]
    largest = max(numpy.abs(both[0]).max(), 1e-300)
    figure, axes = plt.subplots(2, both[0].shape[1], figsize=(4.5 * both[0].shape[1], 9), constrained_layout=True)
    for row, (name, values) in enumerate(zip(("before", "after"), both)):
        for k, component in enumerate("xyz"[:values.shape[1]]):
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
    folder = options.folder or options.results.parent
    with h5py.File(options.results) as h5:
        if "loop" not in h5:
            raise SystemExit(f"{options.results}: no loop in it (tools/plot_results.py draws an identification)")
        loop = h5["loop"]
        frames, held = loop["frames"][:], loop["held_out"][:].astype(bool)
        worst = int(numpy.argmax(loop["before/chi"][:])) if options.frame is None else int(numpy.flatnonzero(frames == options.frame)[0])

        figure, (top, bottom) = plt.subplots(2, 1, figsize=(8, 6), sharex=True, height_ratios=(3, 1))
        for axis in (top, bottom):
            shade(axis, frames, held)
        for name, colour in (("before", BEFORE), ("after", AFTER)):
            top.plot(frames, loop[f"{name}/chi"][:], "o-", ms=3, color=colour, label=name)
        top.plot(frames, loop["after/null_chi"][:], color=NULL, label="noise alone, 95 %")
        top.set_yscale("log")
        top.set_ylabel("χ")
        top.legend()
        load = "force" if "force" in loop else "time"
        bottom.plot(frames, loop[load][:], color="#222222")
        bottom.set_ylabel(f"{load} [{unit(loop[load])}]")
        bottom.set_xlabel("frame")
        figure.savefig(folder / "chi.png", dpi=110)

        if "force" in loop:
            figure, axis = plt.subplots(figsize=(8, 4))
            shade(axis, frames, held)
            for name, colour in (("before", BEFORE), ("after", AFTER)):
                axis.plot(frames, loop[f"{name}/force"][:], "o-", ms=3, color=colour, label=name)
            axis.set_xlabel("frame")
            axis.set_ylabel(f"force, measured − predicted [{unit(loop['force'])}]")
            axis.legend()
            figure.savefig(folder / "force.png", dpi=110)

        for name, face in {"": h5}.items() if "surface" in h5 else [(f"_{name}", h5[name]) for name in ("front", "back")]:
            draw_face(folder, face, loop, name, frames, worst)


if __name__ == "__main__":
    main()
