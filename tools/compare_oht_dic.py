#!/usr/bin/python3
"""Displacement of the open-hole tension test `oht_cfrp`: this program's DIC against DICe.

Reads oht_cfrp.csv (written by test_correlation, Measured.OpenHoleTensionAgreesWithDice); prints the rms differences per order
and draws the fields of one order side by side.
"""
import argparse
import csv
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("csv", type=Path, help="oht_cfrp.csv")
    parser.add_argument("--order", type=int, default=10, help="the one that is drawn")
    parser.add_argument("--picture", type=Path, default=Path("oht_cfrp.png"))
    arguments = parser.parse_args()

    with open(arguments.csv) as stream:
        rows = np.array([[float(value) for value in row.values()] for row in csv.DictReader(stream)])
    rows = rows[np.isfinite(rows).all(1)]
    print("order  points  rms x [px]  rms y [px]  mean x    mean y    rms after an affine fit of the difference")
    for order in np.unique(rows[:, 0]):
        some = rows[rows[:, 0] == order]
        gap = some[:, 3:5] - some[:, 5:7]
        places = np.column_stack([np.ones(len(some)), some[:, 1:3]])
        rest = gap - places @ np.linalg.lstsq(places, gap, rcond=None)[0]
        print(f"{int(order):5d} {len(some):7d} " + " ".join(f"{v:11.4f}" for v in np.sqrt((gap**2).mean(0)))
              + " ".join(f"{v:10.4f}" for v in gap.mean(0)) + " ".join(f"{v:10.4f}" for v in np.sqrt((rest**2).mean(0))))

    some = rows[rows[:, 0] == arguments.order]
    figure, axes = plt.subplots(2, 3, figsize=(10, 13), constrained_layout=True)
    for component, name in enumerate(("u_x", "u_y")):
        for column, (title, values) in enumerate((("imic3d", some[:, 3 + component]), ("DICe", some[:, 5 + component]),
                                                  ("difference", some[:, 3 + component] - some[:, 5 + component]))):
            picture = axes[component, column].scatter(some[:, 1], some[:, 2], c=values, s=60, marker="s")
            axes[component, column].invert_yaxis()
            axes[component, column].set_aspect("equal")
            axes[component, column].set_title(f"{name} [px], {title}", fontsize=9)
            figure.colorbar(picture, ax=axes[component, column])
    figure.suptitle(f"oht_cfrp, order {arguments.order}")
    figure.savefig(arguments.picture, dpi=90)


if __name__ == "__main__":
    main()
