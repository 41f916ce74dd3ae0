#!/usr/bin/python3
"""Sec. 5 of the paper as a virtual experiment: Table 1 (uniaxial, one camera, stereo pair; two meshes) and Figs 22b and 23
(linear hardening beside the power law on the same data). The images are those of inputs/two_faces/virtual.yaml.

Usage: table1.py [--ranks 1] [--program build/release/imic3d] [--output runs/two_faces]

Writes table1.csv, curves.csv (force and residual against the mean strain), fig22b.png and fig23.png, and prints the table."""
import argparse
import csv
import json
import os
import pathlib
import re
import subprocess
import sys
import time

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy
from scipy.optimize import least_squares

ROOT = pathlib.Path(__file__).resolve().parents[1]
NAMES = ("E", "S_y", "H", "delta")
PAPER = {"uniaxial": (198e3, 284.0, 1480.0, 0.0420), "mono": (233e3, 300.0, 1431.0, 0.0419), "stereo": (232e3, 297.0, 1337.0, 0.0420)}


def hardening(plastic, E, S_y, H, delta):
    """Eqs 18 and 19."""
    return H * plastic + S_y * (1.0 + plastic * (E - H) / (delta * S_y)) ** delta


def kirchhoff_stress(strain, parameters):
    """Of uniaxial tension to a logarithmic strain: E (strain - p) = hardening(p), by bisection."""
    E = parameters[0]
    low, high = numpy.zeros_like(strain), numpy.maximum(strain, 0.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        yields = E * (strain - middle) > hardening(middle, *parameters)
        low, high = numpy.where(yields, middle, low), numpy.where(yields, high, middle)
    return E * (strain - 0.5 * (low + high))


def uniaxial(results, area=50.0, gauge=25.0):
    """Fit of F lambda / A against ln(lambda), with noise of 0.5 um on the extensometer and 5 N on the load. Returns values, deviations."""
    with h5py.File(results) as file:
        nodes = file["mesh/nodes"][:]
        top, bottom = nodes[:, 1] > 12.49, nodes[:, 1] < -12.49
        u = file["fields/displacement"][1:, :, 1]
        force = file["frames/force_predicted"][1:]
    random = numpy.random.default_rng(1)
    stretch = 1.0 + (u[:, top].mean(1) - u[:, bottom].mean(1) + random.normal(0.0, 5e-4, len(force))) / gauge
    stress = (force + random.normal(0.0, 5.0, len(force))) / area * stretch  # Kirchhoff
    scale = numpy.array([198e3, 284.0, 1480.0, 0.042])
    model = lambda p: kirchhoff_stress(numpy.log(stretch), p * scale)
    slope = numpy.gradient(stress, numpy.log(stretch))  # the extensometer's noise counts where the curve is steep
    sigma = numpy.hypot(5.0 / area, slope * 5e-4 / gauge)
    fit = least_squares(lambda p: (model(p) - stress) / sigma, [0.9, 0.9, 1.2, 1.2])
    return fit.x * scale, scale * numpy.sqrt(numpy.diag(numpy.linalg.inv(fit.jac.T @ fit.jac)))


def variant(arguments, case, mesh, linear=False):
    """A case of inputs/two_faces with another mesh and, if asked for, the linear law; returns its file and the results' folder."""
    name = f"{case}_{mesh}" + ("_linear" if linear else "")
    text = (ROOT / "inputs/two_faces" / f"{case}.yaml").read_text()
    text = text.replace("coarse.msh", str(ROOT / "inputs/two_faces" / f"{mesh}.msh"))
    text = text.replace("../../runs/two_faces/images", str(arguments.output / "images"))
    text = re.sub(r"output: .*", f"output: {arguments.output / name}", text)
    if linear:
        text = text.replace("hardening: power_linear\n  tie_initial_modulus: true", "hardening: linear")
        text = text.replace(", delta: 0.048", "").replace(", delta]", "]")
    folder = arguments.output / "cases"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.yaml").write_text(text)
    return folder / f"{name}.yaml", arguments.output / name


def run(arguments, command, case):
    environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", OMPI_ALLOW_RUN_AS_ROOT="1",
                       OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1", HWLOC_HIDE_ERRORS="2")
    begin = time.time()
    done = subprocess.run(["mpirun", "--oversubscribe", "-n", str(arguments.ranks), arguments.program, command, str(case)],
                          capture_output=True, text=True, env=environment)
    if done.returncode != 0:
        sys.exit(f"{case} ended with {done.returncode}\n{done.stdout}\n{done.stderr}")
    print(f"{case.stem}: {time.time() - begin:.0f} s", flush=True)


def identified(folder):
    result = json.loads((folder / "result.json").read_text())["parameters"]
    return [result[n]["value"] if n in result else numpy.nan for n in NAMES], [result[n]["standard_deviation"] if n in result else numpy.nan for n in NAMES]


def curves(folder):
    """Mean strain by the DIC of the first face, forces, residuals, for the frames after the reference."""
    with h5py.File(folder / "results.h5") as file:
        nodes = file["surface/nodes"][:]
        face = numpy.abs(nodes[:, 2] - nodes[0, 2]) < 1e-9
        top, bottom = (face & (numpy.abs(nodes[:, 1] - end) < 1e-6) for end in (nodes[face, 1].max(), nodes[face, 1].min()))
        u = file["dic/displacement"][:, :, 1]
        strain = (u[:, top].mean(1) - u[:, bottom].mean(1)) / (nodes[face, 1].max() - nodes[face, 1].min())
        known = numpy.isfinite(strain) & numpy.isfinite(file["residual/rms_model"][:])
        return {"strain": strain[known], "force": file["frames/force_measured"][:][known], "model": file["frames/force_predicted"][:][known],
                "residual": file["residual/rms_model"][:][known], "dic": file["residual/rms_dic"][:][known]}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ranks", type=int, default=1)
    parser.add_argument("--program", default=str(ROOT / "build/release/imic3d"))
    parser.add_argument("--output", type=pathlib.Path, default=ROOT / "runs/two_faces")
    arguments = parser.parse_args()
    arguments.output = arguments.output.resolve()
    truth = json.loads((arguments.output / "images/truth.json").read_text())
    run(arguments, "simulate", ROOT / "inputs/two_faces/uniaxial.yaml")
    columns = {"uniaxial": uniaxial(ROOT / "runs/two_faces/uniaxial/results.h5")}
    for mesh in ("coarse", "fine"):
        for case in ("mono", "stereo", "all"):
            file, folder = variant(arguments, case, mesh)
            run(arguments, "identify", file)
            columns[f"{case}_{mesh}"] = identified(folder)
    linear, linear_folder = variant(arguments, "mono", "coarse", linear=True)
    run(arguments, "identify", linear)

    with open(arguments.output / "table1.csv", "w", newline="") as stream:
        writer = csv.writer(stream)
        head = ["parameter", "truth"]
        for name in columns:
            head += [name, f"{name}_error_percent", f"{name}_noise_percent"]
        writer.writerow(head + [f"paper_{name}" for name in PAPER])
        for k, name in enumerate(NAMES):
            row = [name, truth[name]]
            for values, deviations in columns.values():
                row += [f"{values[k]:.6g}", f"{100 * (values[k] / truth[name] - 1):.3f}", f"{100 * deviations[k] / truth[name]:.4f}"]
            writer.writerow(row + [PAPER[column][k] for column in PAPER])
    print("\n" + (arguments.output / "table1.csv").read_text())

    power, other = curves(arguments.output / "mono_coarse"), curves(linear_folder)
    with open(arguments.output / "curves.csv", "w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["mean_strain", "force_N", "force_power_N", "force_linear_N", "residual_power", "residual_linear", "residual_dic"])
        rows = numpy.stack([power["strain"], power["force"], power["model"], other["model"], power["residual"], other["residual"], power["dic"]], 1)
        writer.writerows([[f"{value:.6g}" for value in row] for row in rows])
    print((arguments.output / "curves.csv").read_text())
    plastic = power["strain"] > 0.0015
    off = lambda data: numpy.max(numpy.abs(data["model"] / data["force"] - 1.0)[plastic])
    print(f"largest gap of the load curve: power law {100 * off(power):.2f} %, linear law {100 * off(other):.2f} %")
    print(f"largest residual over that of pure DIC: power law {numpy.max((power['residual'] / power['dic'])[plastic]):.2f}, linear law {numpy.max((other['residual'] / other['dic'])[plastic]):.2f}")
    for file, label, series in (("fig23.png", "load [kN]", (("force", "recorded", "k-", 1e-3), ("model", "{}", "o-", 1e-3))),
                                ("fig22b.png", "residual [grey levels]", (("dic", "pure DIC", "k-", 1.0), ("residual", "{}", "o-", 1.0)))):
        plt.figure(figsize=(6, 4))
        plt.plot(power["strain"], series[0][3] * power[series[0][0]], series[0][2], label=series[0][1])
        for data, law, colour in ((power, "linear and power law", "#2166ac"), (other, "linear law", "#b2182b")):
            plt.plot(data["strain"], series[1][3] * data[series[1][0]], "o-", color=colour, label=law, markersize=3)
        plt.xlabel("mean strain"), plt.ylabel(label), plt.legend(), plt.tight_layout()
        plt.savefig(arguments.output / file, dpi=120), plt.close()


main()
