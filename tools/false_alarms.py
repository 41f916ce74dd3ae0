#!/usr/bin/python3
"""Tests in which nothing is missing: how often does `imic3d loop` find something, and are its p-values uniform?

fields   an elastic strip whose motion is a formula (tests/cases/fields.py), tables of points with noise
curves   bars of a program of its own (tools/blind_suite.py)
images   the whole pipeline: a plate of 250 x 320 px, images by `imic3d virtual` on a finer and longer mesh, 8 bits, noise
space    images of a plate of 8 mm in three dimensions, made on a finer mesh whose grips are 23 mm behind the cuts
plate    the same with the plate of inputs/paper_pair (500 x 640 px, 29 frames), its own law declared

tools/false_alarms.py {fields,curves,images,space,plate} [--count N] [--first SEED] [--out FOLDER] [--imic3d PROGRAM] [--judge]

Noise is another one in each test. Prints the rate of false alarms with the 95 % bound of Clopper and Pearson, Kolmogorov's test of the p-values of the largest score and of the
energy, and how far parameters are off in units of their standard deviations (1 if these are right). Writes FOLDER/nulls.csv and FOLDER/p_values.png. With --judge
the exit status is 1 if more is found than 5 % (and, of 200 tests or more, if the bound is above 8 %), or p-values are not uniform (1 %). A test
whose result is there is not run again; --judge without --count judges what is there."""

import argparse
import collections
import csv
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import blind

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/cases"))


def strip(folder, planted, seed):
    import fields
    shutil.rmtree(folder / "points", ignore_errors=True)
    fields.tables(folder / "points", 1.0, 0.0, False, (0.0, 0.0), 0.0, seed)
    fields.bar(folder / "strip.msh", -11.0, 11.0, 22, columns=6, half_width=3.5)
    (folder / "case.yaml").write_text(fields.case("points").replace("output: points/run", "output: run"))


def bars(folder, planted, seed):
    import blind_suite
    blind_suite.make(folder, planted, seed)


# Pixels twice as large as those of inputs/paper_pair, elements larger, half the frames: what mesh and noise err by is as large beside each other.
# The test is made in more increments than the loop takes, on elements of 0.2 mm at the hole: those of the test itself are in no real one. (With 0.4 mm S_y, H and delta are off by a standard deviation in the mean.)
LAW = "{law: j2, hardening: power_linear, tie_initial_modulus: true, parameters: {%s}}"
VIRTUAL = """title: Plate, the test
specimen: {{mesh: generate.msh, kinematics: plane_stress, refine: 2, element: quad8, thickness: 0.8, held: bottom, loaded: top}}
cameras: [{{name: front, pixel_size: 0.09, place: {{origin: [124.5, 159.5]}}}}]
material: {law}
simulate: {{control: displacement, clamped: true, centred: true, steps_per_frame: 16, value: [0, 0.012, 0.03, 0.048, 0.06, 0.09, 0.12, 0.15, 0.22, 0.3, 0.44, 0.6, 0.8, 1.0, 1.2, 1.4]}}
virtual: {{size: [250, 320], speckle_size: 5, noise: 0.01, load_noise: 2, static_frames: 5, seed: {seed}, directory: test}}
output: test
"""
DECLARED = """title: Plate, nothing missing
specimen: {{mesh: identify.msh, kinematics: plane_stress, element: quad8, thickness: 0.8, held: bottom, loaded: top}}
cameras: [{{name: front, pixel_size: 0.09, place: {{origin: [124.5, 159.5]}}, images: "test/images/*.png", reference: 0-4}}]
loads: {{file: test/loads.csv, image: frame, time: time_s, force: force_N, noise: 2}}
material: {law}
identify: {{functional: displacement_driven, stages: [{{free: [E, S_y, H, delta]}}]}}
loop: {{draws: 60, rivals: 1, additions: 1, starts: [1.0]}}
output: run
"""


def in_space(text, element):
    """The plate 8 mm thick in three dimensions, 34 mm of it seen."""
    for old, new in (("kinematics: plane_stress, refine: 2, element: quad8", element), ("kinematics: plane_stress, element: quad8", element), ("thickness: 0.8", "thickness: 8.0"), ("noise: 2,", "noise: 20,"), ("noise: 2}", "noise: 20}"), ("159.5", "209.5"), ("[250, 320]", "[250, 420]"), ("speckle_size: 5", "speckle_size: 4"),
                     ("[0, 0.012, 0.03, 0.048, 0.06, 0.09, 0.12, 0.15, 0.22, 0.3, 0.44, 0.6, 0.8, 1.0, 1.2, 1.4]", "[0, 0.038, 0.09, 0.13, 0.15, 0.18, 0.22, 0.26, 0.34, 0.45, 0.65, 0.9, 1.2, 1.5, 1.8, 2.1, 2.5, 2.9]")):
        text = text.replace(old, new)
    return text


def images(program, space=False):
    def make(folder, planted, seed):
        from runs import gmsh
        virtual, declared = VIRTUAL, DECLARED
        if space:
            gmsh("plate_with_hole", folder / "generate.msh", length=80, size_hole=0.7, size_far=1.6)
            gmsh("plate_with_hole", folder / "identify.msh", length=34, size_hole=1.6, size_far=4.0)
            virtual = in_space(virtual, "element: hex20, layers: 3, layer_ratio: 1.6, mid_plane_symmetry: true")
            declared = in_space(declared, "element: hex20, layers: 1, mid_plane_symmetry: true")
        else:
            gmsh("plate_with_hole", folder / "generate.msh", length=40, size_hole=0.8, size_far=2.5)
            gmsh("plate_with_hole", folder / "identify.msh", length=24, size_hole=1.6, size_far=4.0)
        (folder / "virtual.yaml").write_text(virtual.format(law=LAW % "E: 198e3, nu: 0.25, S_y: 284, H: 1480, delta: 0.042", seed=seed))
        (folder / "case.yaml").write_text(declared.format(law=LAW % "E: 190e3, nu: 0.25, S_y: 278, H: 1420, delta: 0.042"))
        with open(folder / "virtual.txt", "w") as log:
            subprocess.run([program, "virtual", "virtual.yaml"], cwd=folder, check=True, stdout=log, stderr=subprocess.STDOUT)
    return make


def plate(program):
    def make(folder, planted, seed):
        for name in ("paper_pair", "plate_with_hole"):
            shutil.copytree(ROOT / "inputs" / name, folder / "inputs" / name, dirs_exist_ok=True)
        test = folder / "inputs/paper_pair/virtual.yaml"
        test.write_text(test.read_text().replace("seed: 1,", f"seed: {seed},"))
        with open(folder / "virtual.txt", "w") as log:
            subprocess.run([program, "virtual", str(test)], check=True, stdout=log, stderr=subprocess.STDOUT)
        loop = (ROOT / "inputs/paper_pair/loop.yaml").read_text().replace("../../runs", "runs").replace("../plate_with_hole", "inputs/plate_with_hole").replace("output: runs/paper_pair/loop", "output: run")
        loop = loop.replace("hardening: linear", "hardening: power_linear\n  tie_initial_modulus: true").replace("S_y: 400, H: 1400", "S_y: 278, H: 1420, delta: 0.042").replace("free: [E, S_y, H]", "free: [E, S_y, H, delta]")
        (folder / "case.yaml").write_text(loop)
    return make


def kinds(program):
    import blind_suite
    plate_truth = dict(E=198e3, S_y=284.0, H=1480.0, delta=0.042)
    return {"fields": (strip, dict(E=200e3, nu=0.3)), "curves": (bars, blind_suite.TRUTH), "images": (images(program), plate_truth), "space": (images(program, space=True), plate_truth), "plate": (plate(program), plate_truth)}


def plot(file, p, title):
    figure, axes = plt.subplots(1, len(p), figsize=(4.2 * len(p), 4.0), constrained_layout=True)
    for axis, (name, values) in zip(axes, p.items()):
        n = len(values)
        axis.plot([0, 1], [0, 1], color="#888888", lw=1)
        band = 1.36 / np.sqrt(n)
        axis.fill_between([0, 1], [-band, 1 - band], [band, 1 + band], color="#888888", alpha=0.15, lw=0, label="uniform, 95 % (Kolmogorov)")
        axis.step(np.sort(values), np.arange(1, n + 1) / n, where="post", color="#1f5fa8", label=f"{n} tests")
        axis.set(xlim=(0, 1), ylim=(0, 1), xlabel=f"p-value of the {name}", ylabel="share of tests below", aspect="equal")
        axis.legend(fontsize=8, loc="lower right")
    figure.suptitle(title, fontsize=9)
    figure.savefig(file, dpi=130)
    plt.close(figure)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("kind", choices=("fields", "curves", "images", "space", "plate"))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--out")
    parser.add_argument("--imic3d", default="build/release/imic3d")
    parser.add_argument("--judge", action="store_true")
    options = parser.parse_args()
    folder = Path(options.out or f"runs/false_alarms/{options.kind}")
    make, truth = kinds(str(Path(options.imic3d).resolve()))[options.kind]
    suite = blind.Suite(folder, options.imic3d, make, truth)
    rows, off, scores = [], {name: [] for name in truth}, collections.defaultdict(list)
    for seed in range(options.first, options.first + options.count):
        where = folder / f"null_{seed}"
        where.mkdir(parents=True, exist_ok=True)
        result = suite.run(where, {}, seed)
        if result is None:
            sys.exit(f"{where}: the program failed, see log.txt")
        before = result["before"]
        for name, its in before["parameters"].items():
            off[name].append((its["value"] - truth[name]) / its["standard_deviation"])
        for one in before["candidates"]:
            size = one["sizes"][0]
            if size["standard_deviation"] > 0:
                scores[one["name"]].append(size["size"] / size["standard_deviation"])
        best = max((one for one in before["candidates"] if one["kappa"] >= 0.05), key=lambda one: one["z"], default={"name": "", "z": 0.0})
        rows.append(dict(seed=seed, verdict=result["verdict"], named=" + ".join(result["named"]), p_scores=before["largest_p"], p_energy=before["omnibus"]["p"], largest=best["name"], z=best["z"],
                         threshold=before["threshold"], chi=before["chi"]["fitted"], null_chi=before["chi"]["null_fitted"], held_out=before["chi"]["held_out"], null_held_out=before["chi"]["null_held_out"]))
        row = rows[-1]
        print(f"{seed}: {row['verdict']:14} {row['named']:24} largest {row['z']:.2f} of {row['threshold']:.2f} ({row['largest']}), p {row['p_scores']:.3f}, energy p {row['p_energy']:.3f}", flush=True)
    with open(folder / "nulls.csv", "w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    n, alarms = len(rows), sum(row["verdict"] != "nothing found" for row in rows)
    bound = stats.beta.ppf(0.95, alarms + 1, n - alarms) if alarms < n else 1.0
    lower = stats.beta.ppf(0.05, alarms, n - alarms + 1) if alarms > 0 else 0.0
    print(f"\n{alarms} false alarms of {n}: {100 * alarms / n:.1f} % (95 % bounds, one-sided: {100 * lower:.1f} and {100 * bound:.1f} %)")
    p = {"largest score": np.array([row["p_scores"] for row in rows]), "energy": np.array([row["p_energy"] for row in rows])}
    uniform = True
    for name, values in p.items():
        test = stats.kstest(values, "uniform")
        uniform = uniform and test.pvalue > 0.01
        print(f"p-values of the {name}: below 1, 5, 10, 50 %: " + ", ".join(f"{100 * np.mean(values <= level):.1f}" for level in (0.01, 0.05, 0.1, 0.5)) + f" %; Kolmogorov {test.statistic:.3f}, p {test.pvalue:.3f}")
    print(f"chi above the null's 95 %: fitted {sum(r['chi'] > r['null_chi'] for r in rows)}, held out {sum(r['held_out'] > r['null_held_out'] for r in rows)} of {n}")
    for name, values in off.items():
        if values:
            print(f"{name}: (found - true)/standard deviation: mean {np.mean(values):+.2f}, rms {np.sqrt(np.mean(np.square(values))):.2f}, within 1.96: {100 * np.mean(np.abs(values) < 1.96):.0f} %")
    for name, values in scores.items():
        print(f"score of {name}: size/standard deviation mean {np.mean(values):+.2f}, deviation {np.std(values):.2f} (1 if the null is right)")
    plot(folder / "p_values.png", p, f"{options.kind}: {alarms} false alarms of {n}")
    if options.judge:
        # Of few tests: no more than 5 % would give in 99 of 100 cases.
        limit = 0.05 * n if n >= 200 else stats.binom.ppf(0.99, n, 0.05)
        if alarms > limit or (n >= 200 and bound > 0.08) or not uniform:
            sys.exit("not calibrated: see above")


if __name__ == "__main__":
    main()
