#!/usr/bin/python3
"""Force and grey-level residual of an identified model on every frame, as a Markdown table.

Usage: frame_table.py results.h5 [--frames 8,10,52]
Columns: frame, use (fitted, held out, not used), measured and predicted force and their difference, residual of the model
and of pure DIC [grey level, smoothed images].
"""
import argparse

import h5py
import numpy

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("results")
parser.add_argument("--frames", help="only these")
arguments = parser.parse_args()
with h5py.File(arguments.results) as file:
    number = file["frames/number"][:]
    use = [("not used", "fitted", "held out", "reference")[code] for code in file["frames/use"][:]]
    measured, predicted = file["frames/force_measured"][:], file["frames/force_predicted"][:]
    model, dic = file["residual/rms_model"][:], file["residual/rms_dic"][:]
wanted = set(map(int, arguments.frames.split(","))) if arguments.frames else set(number.tolist())
print("| frame | use | measured | predicted | difference | model | DIC |\n|---|---|---|---|---|---|---|")
for i, frame in enumerate(number):
    if frame in wanted and numpy.isfinite(predicted[i]):
        print(f"| {frame} | {use[i]} | {measured[i]:.0f} | {predicted[i]:.0f} | {predicted[i] - measured[i]:+.0f} | {model[i]:.2f} | {dic[i]:.2f} |")
