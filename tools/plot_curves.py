#!/usr/bin/python3
"""Draws curves.csv of one or several runs of imic3d identify: measured and predicted stress, and their difference.

Usage: plot_curves.py PICTURE.png RUN_FOLDER [RUN_FOLDER …]     one row of pictures an experiment, one colour a run
"""
import csv
import pathlib
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

COLOURS = ["#b2182b", "#2166ac", "#1b7837", "#762a83", "#b35806"]


def read(folder):
    """{experiment: {curve: [(strain, measured, predicted, use)]}} and the unit of the stress."""
    experiments, unit = {}, ""
    with open(pathlib.Path(folder) / "curves.csv", newline="") as file:
        for row in csv.DictReader(file):
            unit = next(key for key in row if key.startswith("measured_"))[len("measured_"):]
            values = (float(row["log_strain"]), float(row["measured_" + unit]), float(row["predicted_" + unit]), row["use"])
            experiments.setdefault(row["experiment"], {}).setdefault(row["curve"], []).append(values)
    return experiments, unit


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    runs = [(pathlib.Path(folder).name, *read(folder)) for folder in sys.argv[2:]]
    names = list(runs[0][1])
    figure, axes = plt.subplots(len(names), 2, figsize=(13, 3.4 * len(names)), squeeze=False)
    for (left, right), name in zip(axes, names):
        for k, (run, experiments, unit) in enumerate(runs):
            for i, rows in enumerate(experiments.get(name, {}).values()):
                strain, measured, predicted, use = zip(*rows)
                judged = [m - p if u != "not judged" else float("nan") for m, p, u in zip(measured, predicted, use)]
                if k == 0:
                    left.plot(strain, measured, color="#999999", lw=0.8, label="measured" if i == 0 else None)
                    held = [s if u == "held out" else float("nan") for s, u in zip(strain, use)]
                    if any(u == "fitted" for u in use):
                        left.plot(held, measured, color="#e08214", lw=0.8, label="held out" if "held out" in use else None)
                left.plot(strain, predicted, color=COLOURS[k % 5], lw=0.8, label=run if i == 0 else None)
                right.plot(strain, judged, color=COLOURS[k % 5], lw=0.6)
        left.set(title=name, xlabel="logarithmic strain", ylabel=f"stress [{unit}]")
        right.set(title="measured − predicted", xlabel="logarithmic strain", ylabel=f"[{unit}]")
        right.axhline(0, color="k", lw=0.5)
        left.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(sys.argv[1], dpi=80)


main()
