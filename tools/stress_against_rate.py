#!/usr/bin/python3
"""What bars at several rates say by themselves, without any law: the mean stress of each group of bars at chosen strains with its standard error, and how much
it grows with a decade of the rate between groups. A yield stress that goes with the logarithm of the rate has one slope; heating lets the difference fall with strain.

tools/stress_against_rate.py CASE.yaml [--skip GROUP ...] [--strains E ...] [--picture FILE.png]

CASE: a case file with `experiments` (docs/curves.md). --skip: groups that are shown, but between which no slope is taken."""

import argparse
import csv
from pathlib import Path

import numpy as np
import yaml

UNITS = {"Pa": 1e-6, "kPa": 1e-3, "MPa": 1.0, "GPa": 1e3, "psi": 6.894757e-3, "ksi": 6.894757}


def read(path, one):
    """Time, engineering strain and stress [MPa] up to the largest force."""
    names, rows = None, []
    with open(path, errors="replace") as stream:
        for line in stream:
            cells = [cell.strip().strip('"') for cell in next(csv.reader([line.replace(";", ",").replace("\t", ",")]))] if line.strip() else []
            if names is None:
                names = [cells.index(one[key]) for key in ("time", "strain", "stress")] if one["strain"] in cells and one["stress"] in cells else None
                continue
            try:
                rows.append([float(cells[k]) for k in names])
            except (ValueError, IndexError):
                pass
    time, strain, stress = np.array(rows).T
    end = np.argmax(stress) + 1
    return time[:end], strain[:end] * one.get("strain_scale", 1.0), stress[:end] * UNITS[one.get("stress_unit", "MPa")]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("case")
    parser.add_argument("--skip", nargs="*", default=[])
    parser.add_argument("--strains", nargs="+", type=float, default=[0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5])
    parser.add_argument("--picture")
    options = parser.parse_args()
    grid = np.array(options.strains)
    groups = {}
    for one in yaml.safe_load(open(options.case))["experiments"]:
        stresses, rates = [], []
        for file in one["file"]:
            time, strain, stress = read(Path(options.case).parent / file, one)
            furthest = np.maximum.accumulate(strain)
            forward = np.r_[True, np.diff(furthest) > 0]
            stresses.append(np.interp(grid, furthest[forward], stress[forward], right=np.nan) * (1.0 + grid))
            inside = (strain > 0.02) & (strain < 0.2)
            rates.append(np.polyfit(time[inside], np.log1p(strain[inside]), 1)[0])
        stresses = np.array(stresses)
        there = np.sum(np.isfinite(stresses), axis=0)
        mean, error = np.full(len(grid), np.nan), np.full(len(grid), np.nan)
        for k in np.flatnonzero(there >= 3):
            its = stresses[np.isfinite(stresses[:, k]), k]
            mean[k], error[k] = its.mean(), its.std(ddof=1) / np.sqrt(len(its))
        groups[one["name"]] = (float(np.median(rates)), mean, error, there)
    cell = lambda a, b, digits: f"{a:8.{digits}f} +-{b:4.{digits}f}" if np.isfinite(a) else " " * 13 + "-"
    print("true stress [MPa] at the engineering strain, mean and standard error of the bars\n" + " " * 26 + " ".join(f"{strain:14.2f}" for strain in grid))
    for name, (rate, mean, error, there) in groups.items():
        print(f"{name:14} {rate:8.2g} /s " + " ".join(cell(a, b, 0) for a, b in zip(mean, error)))
        print(" " * 21 + "bars " + " ".join(f"{n:14d}" for n in there))
    ordered = sorted((name for name in groups if name not in options.skip), key=lambda name: groups[name][0])
    print("growth of the stress with a decade of the rate [MPa]")
    for low, high in zip(ordered, ordered[1:]):
        decades = np.log10(groups[high][0] / groups[low][0])
        print(f"{low + ' to ' + high:26}" + " ".join(cell((b - a) / decades, np.hypot(c, d) / decades, 1) for a, b, c, d in zip(groups[low][1], groups[high][1], groups[low][2], groups[high][2])))
    if options.picture:
        import matplotlib
        matplotlib.use("Agg")
        import matplotlib.pyplot as plt
        figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), constrained_layout=True)
        for name, (rate, mean, error, _) in groups.items():
            left.errorbar(grid, mean, error, label=f"{name} ({rate:.2g} /s)", capsize=2)
        for k, strain in enumerate(grid):
            right.errorbar([groups[name][0] for name in ordered], [groups[name][1][k] for name in ordered], [groups[name][2][k] for name in ordered], label=f"{strain:g}", marker="o", capsize=2)
        left.set(xlabel="engineering strain", ylabel="true stress [MPa]")
        right.set(xscale="log", xlabel="true strain rate [1/s]", ylabel="true stress [MPa]")
        left.legend(), right.legend(title="strain", fontsize=7)
        figure.savefig(options.picture, dpi=110)


if __name__ == "__main__":
    main()
