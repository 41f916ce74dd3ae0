#!/usr/bin/python3
"""Processor time of an identification with direct and with perturbed sensitivities, and of one simulation of the same series.

Usage: sensitivity_cost.py CASE VIRTUAL [--keys direct,perturbed] [--repeats 1] [--program imic3d] [--output FOLDER]

CASE is an identification, VIRTUAL the virtual test that its images were made by, whose `simulate` section gives the one simulation
on CASE's own mesh. One rank, one thread. The whole of each program counts, images and report included. Prints a table.
"""
import argparse
import json
import os
import pathlib
import re
import resource
import statistics
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[1]


def absolute(text, folder):
    """The files that a case names, wherever it is copied to."""
    return re.sub(r'(mesh: |file: |images: "?)(?!/)([^,}\s"]+)', lambda m: m[1] + os.path.normpath(folder / m[2]), text)


def section(text, name):
    return re.search(rf"^{name}:.*?(?=^\S|\Z)", text, re.M | re.S)[0]


def seconds(command):
    """Processor time, user and system, of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1"))
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}\n{done.stdout}\n{done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", type=pathlib.Path)
    parser.add_argument("virtual", type=pathlib.Path)
    parser.add_argument("--keys", default="direct,perturbed")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--program", default=str(ROOT / "build/release/imic3d"))
    parser.add_argument("--output", type=pathlib.Path, default=ROOT / "runs/sensitivity_cost")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    case = re.sub(r"^output:.*\n", "", absolute(arguments.case.read_text(), arguments.case.resolve().parent), flags=re.M)
    case = re.sub(r"^  sensitivities:.*\n", "", case, flags=re.M)
    made = arguments.virtual.read_text()
    simulation = "".join(section(case, name) for name in ("title", "units", "specimen")) + section(made, "material") + section(made, "simulate")
    runs = {"simulate": ("simulate", simulation + "output: simulate\n")}
    for key in arguments.keys.split(","):
        runs[key] = ("identify", case.replace("identify:\n", f"identify:\n  sensitivities: {key}\n") + f"output: {key}\n")
    times = {name: [] for name in runs}
    for _ in range(arguments.repeats):
        for name, (command, text) in runs.items():
            path = arguments.output / f"{name}.yaml"
            path.write_text(text)
            times[name].append(seconds([arguments.program, command, path]))
    one = statistics.median(times["simulate"])
    print(f"{'run':12} {'processor s':>12} {'simulations':>12}  parameters")
    for name in runs:
        found = ""
        if name != "simulate":
            result = json.loads((arguments.output / name / "result.json").read_text())
            found = "  ".join(f"{p} {v['value']:.6g}" for p, v in result["parameters"].items())
        median = statistics.median(times[name])
        print(f"{name:12} {median:12.1f} {median / one:12.2f}  {found}")


if __name__ == "__main__":
    main()
