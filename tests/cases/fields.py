#!/usr/bin/python3
"""Displacement fields of another program in `imic3d loop`: an elastic strip whose motion is a formula, sampled at points with noise, loaded and unloaded.
With nothing missing nothing is found; a magnification that drifts with the clock is named, in tables in pixels whose axes are turned.

Usage: fields.py EXECUTABLE [--nulls N]    (N: only tests with nothing missing, each with noise of its own; how often something is found)
"""
import json
import math
import pathlib
import shutil
import sys
import tempfile

import numpy

from runs import bar, end, require, run

CASE = """
title: Strip
specimen: {{mesh: strip.msh, kinematics: plane_stress, thickness: 2, held: bottom, loaded: top}}
fields: {{files: '{name}/points_*.csv', at_rest: 1-3, {axes}}}
{loads}
material: {{law: elastic, parameters: {{E: 190e3, nu: 0.28}}}}
identify: {{functional: displacement_driven, stages: [{{free: [{free}]}}]}}
loop: {{draws: 60, modes: 40, additions: 2, rivals: 3, starts: [1.0]}}
output: {name}/run
"""
E, NU, NOISE, LOAD_NOISE = 200e3, 0.3, 5e-4, 10.0
REST, LEVELS = 3, numpy.concatenate([numpy.linspace(0.25, 1.0, 4), numpy.linspace(0.75, 0.0, 4), numpy.linspace(0.5, 1.0, 3)])


def tables(folder, scale, turn, y_down, origin, drift=0.0, seed=1):
    """Points, every 1 mm of a strip 8 mm wide and 24 mm long."""
    random = numpy.random.default_rng(seed)
    folder.mkdir(parents=True)
    x, y = numpy.meshgrid(numpy.linspace(-3.8, 3.8, 17), numpy.linspace(-11.9, 11.9, 49))
    at = numpy.column_stack([x.ravel(), y.ravel()])
    angle = numpy.radians(turn)
    seen = numpy.array([[numpy.cos(angle), -numpy.sin(angle)], [numpy.sin(angle), numpy.cos(angle)]]) / scale
    if y_down:
        seen = numpy.diag([1.0, -1.0]) @ seen
    reference = random.normal(size=at.shape) * NOISE
    rows = ["frame,time,force"]
    strain = 1.2e-3 * LEVELS
    for number in range(REST + len(LEVELS)):
        clock = max(0, number - REST + 1)
        e = strain[number - REST] if number >= REST else 0.0
        u = at * [-NU * e, e]
        u = u + drift * clock / len(LEVELS) * (at + u) + reference + random.normal(size=at.shape) * NOISE
        table = numpy.column_stack([at @ seen.T + origin, u @ seen.T])
        numpy.savetxt(folder / f"points_{number:02}.csv", table, delimiter=",", header="another program's words\nX,Y,U,V", comments="", fmt="%.8g")
        rows.append(f"{number + 1},{clock},{E * e * 16 + random.normal() * LOAD_NOISE:.3f}")
    (folder / "loads.csv").write_text("\n".join(rows) + "\n")


def main():
    program = sys.argv[1]
    folder = pathlib.Path(tempfile.mkdtemp(prefix="imic3d_fields_"))
    bar(folder / "strip.msh", -11.0, 11.0, 22, columns=6, half_width=3.5)
    columns = "columns: {x: X, y: Y, u: U, v: V}"

    def loop(name, axes, ranks, loads=True, free="E, nu"):
        text = f"loads: {{file: {name}/loads.csv, image: frame, time: time, force: force, noise: {LOAD_NOISE}}}" if loads else ""
        (folder / f"{name}.yaml").write_text(CASE.format(name=name, axes=f"{columns}{axes}", loads=text, free=free).replace("thickness: 2", "thickness: 2.2857142857"))
        run(program, "loop", folder / f"{name}.yaml", ranks)
        return json.loads((folder / name / "run/result.json").read_text())

    if "--nulls" in sys.argv:
        count, verdicts, chi = int(sys.argv[sys.argv.index("--nulls") + 1]), [], []
        for seed in range(100, 100 + count):
            tables(folder / f"null_{seed}", 1.0, 0.0, False, (0.0, 0.0), 0.0, seed)
            result = loop(f"null_{seed}", "", 1)
            verdicts.append(result["verdict"])
            chi.append(result["before"]["chi"]["fitted"] / result["before"]["chi"]["null_fitted"])
            print(seed, result["verdict"], result["named"], f"chi {chi[-1]:.3f} of the null's 95 %", flush=True)
        alarms = sum(v != "nothing found" for v in verdicts)
        above = sum(c > 1.0 for c in chi)
        # 5 % of the largest score and 1 % of the energy are asked for; binomial, 99 %.
        limit = next(k for k in range(count + 1) if sum(math.comb(count, i) * 0.06**i * 0.94 ** (count - i) for i in range(k + 1)) > 0.99)
        require(alarms <= limit, f"false alarms: {alarms} of {count} (at most {limit}); chi above the null's 95 %: {above}")
        end()
        return

    # The mesh is 7 mm wide within a strip of 8: as thick as to carry the strip's force.
    tables(folder / "nothing", 1.0, 0.0, False, (0.0, 0.0))
    result = loop("nothing", "", 1)
    found = result["before"]["parameters"]
    require(result["verdict"] == "nothing found", f"nothing is missing: {result['sentence']}")
    for name, truth in (("E", E), ("nu", NU)):
        off = (found[name]["value"] - truth) / found[name]["standard_deviation"]
        require(abs(off) < 4, f"{name} {found[name]['value']:.5g} +- {found[name]['standard_deviation']:.2g}, true {truth:g}")

    drift = 1.5e-3
    tables(folder / "drift", 0.05, 12.0, True, (300.0, 410.0), drift, 2)
    result = loop("drift", ", scale: 0.05, rotation: 12, y_down: true, origin: [300, 410]", 2)
    require(result["verdict"] in ("attributed", "ambiguous") and "magnification drift" in result["set"], f"{result['verdict']}: {result['set']}")
    size = next(t for t in result["rounds"][0]["trials"] if t["candidate"] == "magnification drift")["parameters"]["magnification_drift"]
    require(abs(size["value"] - drift) < 4 * size["standard_deviation"] + 0.02 * drift, f"drift {size['value']:.3g} +- {size['standard_deviation']:.1g}, planted {drift:g}")
    before, after = result["before"]["chi"], result["after"]["chi"]
    require(before["held_out"] > 1.3 * before["null_held_out"] and after["held_out"] < 1.05 * after["null_held_out"],
            f"held-out chi {before['held_out']:.2f} -> {after['held_out']:.2f}, null {after['null_held_out']:.2f}")
    require((folder / "drift/run/results.h5").exists() and result["before"]["chi"]["checkerboard"] > result["after"]["chi"]["checkerboard"], "the checkerboard agrees")

    shutil.copytree(folder / "nothing", folder / "no_force", ignore=shutil.ignore_patterns("loads.csv", "run"))
    result = loop("no_force", "", 1, loads=False, free="nu")
    nu = result["before"]["parameters"]["nu"]
    require(result["verdict"] == "nothing found" and abs(nu["value"] - NU) < 4 * nu["standard_deviation"] < 0.1,
            f"without a load record nothing is missing, and nu {nu['value']:.4f} +- {nu['standard_deviation']:.1g}, true {NU}")
    end()


main()
