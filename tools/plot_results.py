#!/usr/bin/python3
"""Curves of a run as PNG files, from its results.h5.

Usage: tools/plot_results.py results.h5 [--folder FOLDER]

Makes parameters.png (values against the iteration), force.png (measured and predicted against the frame) and
residual.png (grey-level residual of the model and of pure DIC against the frame). Frames that are held out are hollow.
A figure whose data the file does not have is left out."""
import argparse
import pathlib
import sys

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy

MEASURED, MODEL, DIC = "#222222", "#b2182b", "#2166ac"


def texts(dataset):
    return [text.decode() if isinstance(text, bytes) else str(text) for text in dataset[()]]


def finite(values):
    return numpy.isfinite(values).any()


def text_of(dataset):
    value = dataset[()]
    return value.decode() if isinstance(value, bytes) else str(value)


def unit(dataset):
    value = dataset.attrs["unit"]
    return value.decode() if isinstance(value, bytes) else str(value)


def points(axis, frames, values, held, colour, label, line=True):
    """A curve whose held-out frames are hollow."""
    axis.plot(frames, values, color=colour, lw=1.2 if line else 0, label="_")
    axis.plot(frames[~held], values[~held], "o", ms=4, color=colour, label=label)
    axis.plot(frames[held], values[held], "o", ms=5, mfc="white", color=colour)


def plot_parameters(h5):
    group = h5["identification/iterations"]
    count = int(group["count"][0])
    if count < 2:
        return None
    names, units = texts(h5["identification/parameters"]), texts(h5["identification/units"])
    values, stage = group["values"][:count], group["stage"][:count]
    moved = [p for p in range(len(names)) if numpy.ptp(values[:, p]) > 0]
    if not moved:
        return None
    figure, axes = plt.subplots(len(moved), 1, figsize=(7, 1.2 + 1.7 * len(moved)), sharex=True, squeeze=False)
    for axis, p in zip(axes[:, 0], moved):
        axis.plot(values[:, p], "o-", ms=4, lw=1.2, color=DIC)
        axis.set_ylabel(f"{names[p]} [{units[p]}]")
        for start in numpy.flatnonzero(numpy.diff(stage)) + 0.5:
            axis.axvline(start, color="#bbbbbb", lw=0.8)
    axes[-1, 0].set_xlabel("iteration (lines: a new stage)")
    return figure


def plot_force(h5):
    frames, held = h5["frames/number"][:], h5["frames/use"][:] == 2
    measured, predicted = h5["frames/force_measured"], h5["frames/force_predicted"]
    if not finite(predicted[:]) and not finite(measured[:]):
        return None
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(7, 6), sharex=True, height_ratios=[2, 1])
    points(top, frames, measured[:], held, MEASURED, "measured", line=False)
    top.plot(frames, predicted[:], color=MODEL, lw=1.5, label="predicted")
    top.set_ylabel(f"force [{unit(measured)}]")
    top.legend()
    points(bottom, frames, measured[:] - predicted[:], held, MODEL, "measured - predicted")
    bottom.axhline(0, color="#bbbbbb", lw=0.8)
    bottom.set_ylabel(f"measured - predicted [{unit(measured)}]")
    bottom.set_xlabel("frame (hollow: held out)")
    return figure


def plot_residual(h5):
    frames, held = h5["frames/number"][:], h5["frames/use"][:] == 2
    model, dic = h5["residual/rms_model"][:], h5["residual/rms_dic"][:]
    if not finite(model) and not finite(dic):
        return None
    figure, axis = plt.subplots(figsize=(7, 4))
    points(axis, frames, model, held, MODEL, "identified model")
    points(axis, frames, dic, held, DIC, "pure DIC")
    noise = h5["residual/noise"][0]
    if numpy.isfinite(noise):
        axis.axhline(noise * 2**0.5, color="#888888", ls="--", lw=1, label="noise of two images")
    axis.set_xlabel("frame (hollow: held out)")
    axis.set_ylabel("residual, rms [grey level]")
    axis.set_ylim(bottom=0)
    axis.legend()
    return figure


FIGURES = {"parameters": (plot_parameters, "identification/iterations"), "force": (plot_force, "frames"),
           "residual": (plot_residual, "residual")}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=pathlib.Path)
    parser.add_argument("--folder", type=pathlib.Path, help="where the figures go; beside the results if not given")
    arguments = parser.parse_args()
    folder = arguments.folder or arguments.results.parent
    try:
        h5 = h5py.File(arguments.results, "r")
    except OSError as error:
        sys.exit(f"{arguments.results}: cannot be read: {error}")
    with h5:
        for name, (plot, group) in FIGURES.items():
            figure = plot(h5) if group in h5 else None
            if figure is None:
                continue
            figure.suptitle(text_of(h5["case/title"]))
            figure.tight_layout()
            figure.savefig(folder / f"{name}.png", dpi=120)
            plt.close(figure)
            print(folder / f"{name}.png")


if __name__ == "__main__":
    main()
