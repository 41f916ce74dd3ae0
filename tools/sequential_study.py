#!/usr/bin/python3
"""The paper's Sec. 4.4: each parameter identified from wrong initial guesses, the others at their true values.

Usage: sequential_study.py CASE TRUTH [--starts 0.8,0.9,1.1,1.2] [--parameters E,S_y,H,delta] [--ranks 2] [--output FOLDER]

CASE has one stage for each parameter, TRUTH is a JSON file with the true values. Every run is one `imic3d identify`.
Writes runs.csv (one line for each run) and table.csv (one for each parameter, beside the paper's figures) and prints them.
"""
import argparse
import csv
import json
import os
import pathlib
import re
import subprocess
import sys
import time

import numpy

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAPER = {  # |mean|, deviation [%]
    "3d": {"E": (0.07, 0.012), "S_y": (0.16, 0.017), "H": (1.9, 0.01), "delta": (1.3, 0.012)},
    "plane_stress": {"E": (0.15, 0.009), "S_y": (0.12, 0.017), "H": (0.9, 0.045), "delta": (0.6, 0.008)}}


def case_for(base, folder, name, start, truth):
    """The case with only the stage of `name`, which starts from `start` times the true value."""
    text = base.read_text()
    values = {p: truth[p] * (start if p == name else 1.0) for p in PAPER["3d"]}
    text = re.sub(r"parameters: \{.*\}", "parameters: {nu: 0.25, %s}" % ", ".join(f"{p}: {v!r}" for p, v in values.items()), text)
    text = "\n".join(line for line in text.splitlines()
                     if not re.match(r"\s*- \{free:", line) or re.match(rf"\s*- \{{free: \[{name}\]", line)) + "\n"
    text = re.sub(r'(mesh: |file: |images: "?)(?!/)([^,}\s"]+)', lambda m: m[1] + str((base.parent / m[2]).resolve().parent / pathlib.Path(m[2]).name), text)
    text = re.sub(r"output: .*", "output: results", text)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.yaml").write_text(text)
    return folder / "case.yaml"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", type=pathlib.Path)
    parser.add_argument("truth", type=pathlib.Path)
    parser.add_argument("--starts", default="0.8,0.9,1.1,1.2", help="initial guess / true value")
    parser.add_argument("--parameters", default="E,S_y,H,delta")
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--program", default=str(ROOT / "build/release/imic3d"))
    parser.add_argument("--output", type=pathlib.Path, default=ROOT / "runs/sequential_study")
    parser.add_argument("--limit", type=float, help="end with status 1 if an error exceeds this times the paper's mean error")
    arguments = parser.parse_args()
    truth = json.loads(arguments.truth.read_text())
    paper = PAPER["plane_stress" if "kinematics: plane_stress" in arguments.case.read_text() else "3d"]
    environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", OMPI_ALLOW_RUN_AS_ROOT="1",
                       OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1", HWLOC_HIDE_ERRORS="2")
    arguments.output.mkdir(parents=True, exist_ok=True)
    runs = []
    for name in arguments.parameters.split(","):
        for start in map(float, arguments.starts.split(",")):
            case = case_for(arguments.case, arguments.output / f"{name}_{start:g}", name, start, truth)
            begin = time.time()
            done = subprocess.run(["mpirun", "--oversubscribe", "-n", str(arguments.ranks), arguments.program, "identify", str(case)],
                                  capture_output=True, text=True, env=environment)
            if done.returncode not in (0, 3):  # 3: a stage did not converge
                sys.exit(f"{case} ended with {done.returncode}\n{done.stdout}\n{done.stderr}")
            result = json.loads((case.parent / "results/result.json").read_text())
            value, sd = (result["parameters"][name][key] for key in ("value", "standard_deviation"))
            runs.append({"parameter": name, "start": start, "value": value, "error_percent": 100 * (value / truth[name] - 1),
                         "predicted_deviation_percent": 100 * sd / truth[name], "iterations": result["iterations_per_stage"][0],
                         "seconds": round(time.time() - begin)})
            print("  ".join(f"{key} {v:.6g}" if isinstance(v, float) else f"{key} {v}" for key, v in runs[-1].items()), flush=True)

    table = []
    for name in arguments.parameters.split(","):
        mine = [run for run in runs if run["parameter"] == name]
        errors = numpy.array([run["error_percent"] for run in mine])
        table.append({"parameter": name, "mean_error_percent": round(errors.mean(), 4),
                      "deviation_over_starts_percent": round(errors.std(ddof=1), 5) if len(errors) > 1 else "",
                      "paper_mean_error_percent": paper[name][0], "paper_deviation_percent": paper[name][1],
                      "noise_percent": round(mine[0]["predicted_deviation_percent"], 5),
                      "iterations": " ".join(str(run["iterations"]) for run in mine)})
    for file, rows in (("runs.csv", runs), ("table.csv", table)):
        with open(arguments.output / file, "w", newline="") as stream:
            writer = csv.DictWriter(stream, rows[0])
            writer.writeheader()
            writer.writerows(rows)
    print("\n" + (arguments.output / "table.csv").read_text())
    worst = max(abs(row["mean_error_percent"]) / row["paper_mean_error_percent"] for row in table)
    if arguments.limit and worst > arguments.limit:
        sys.exit(f"an error is {worst:.2f} times the paper's; allowed {arguments.limit}")


main()
