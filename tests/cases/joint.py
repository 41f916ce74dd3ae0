#!/usr/bin/python3
"""Several tests of one material in one `imic3d loop`: two elastic strips measured as displacement fields, and bars measured as curves, all made from
formulas with noise. The load cell of the first strip reads 6 % too much: that strip alone cannot show it, the three together do.

Usage: joint.py EXECUTABLE [--ranks 2]
"""
import json
import sys

import numpy

import fields
from runs import bar, end, figures, left_behind, ranks_of, require, run, same_page, workspace

GAIN = 1.06
LAW = "{law: j2, hardening: voce, parameters: {E: 190e3, nu: 0.28, S_y: 2000, S_inf: 2100, b: 10, H: 0}}"  # nothing yields
BARS = """
title: Bars
material: LAW
experiments: [{name: bars, file: "bars/*.csv", strain: strain, stress: stress, time: time, noise: 0.5}]
identify: {stages: [{free: [E, nu]}]}
output: bars/run
""".replace("LAW", LAW)
ALL = """
title: Two strips and bars
tests:
  - {name: first strip, case: first.yaml}
  - {name: second strip, case: second.yaml}
  - {name: bars, case: bars.yaml}
loop: {draws: 60, additions: 2, rivals: 4, starts: [1.0]}
output: all
"""


def main():
    program = sys.argv[1]
    folder = workspace("joint")
    bar(folder / "strip.msh", -11.0, 11.0, 22, columns=6, half_width=3.5)
    for name, seed in (("first", 5), ("second", 6)):
        fields.tables(folder / name, 1.0, 0.0, False, (0.0, 0.0), seed=seed)
        (folder / f"{name}.yaml").write_text(fields.case(name).replace("{law: elastic, parameters: {E: 190e3, nu: 0.28}}", LAW))
    loads = (folder / "first/loads.csv").read_text().splitlines()
    rows = [line.split(",") for line in loads[1:]]
    (folder / "first/loads.csv").write_text("\n".join([loads[0]] + [f"{a},{b},{GAIN * float(c):.3f}" for a, b, c in rows]) + "\n")
    random = numpy.random.default_rng(7)
    (folder / "bars").mkdir()
    for number in range(4):
        strain = numpy.linspace(0, 1.2e-3, 60)
        stress = fields.E * (1 + 5e-4 * random.normal()) * strain * numpy.exp(-strain) + 0.5 * random.normal(size=60)
        table = numpy.column_stack([1e4 * strain, numpy.expm1(strain), numpy.where(strain > 0, stress, 0)])
        numpy.savetxt(folder / f"bars/{number}.csv", table, delimiter=",", header="time,strain,stress", comments="", fmt="%.8g")
    (folder / "bars.yaml").write_text(BARS)
    (folder / "all.yaml").write_text(ALL)

    run(program, "loop", folder / "first.yaml", 1)
    alone = json.loads((folder / "first/run/result.json").read_text())
    require(alone["verdict"] == "nothing found" and "force gain" in alone["invisible"], f"the first strip alone: {alone['verdict']}, invisible: {alone['invisible']}")
    E = alone["before"]["parameters"]["E"]
    require(abs(E["value"] - GAIN * fields.E) < 4 * E["standard_deviation"] < 0.03 * fields.E, f"its E is that of the load cell: {E['value']:.0f} +- {E['standard_deviation']:.0f}")

    run(program, "loop", folder / "all.yaml", ranks_of(sys.argv))
    result = json.loads((folder / "all/result.json").read_text())
    # A first strip that is thicker is the same thing, and one that is stiffer all over.
    twins = {"force gain (first strip)", "thickness (first strip)"}
    require(result["named"] == ["force gain (first strip)"] and twins <= set(result["set"]) <= twins | {"stiff or soft region (first strip)"}, f"together: {result['sentence']}")
    for when in ("before", "after"):
        print(when, {name: f"{one['value']:.6g} +- {one['standard_deviation']:.2g}" for name, one in result[when]["parameters"].items()})
    found = result["after"]["parameters"]
    gain = next(one for name, one in found.items() if name.startswith("force_gain"))
    require(abs(gain["value"] - GAIN) < 4 * gain["standard_deviation"] < 0.04, f"gain {gain['value']:.4f} +- {gain['standard_deviation']:.2g}, planted {GAIN}")
    require(abs(found["E"]["value"] / fields.E - 1) < 0.004, f"E {found['E']['value']:.0f}, true {fields.E:.0f}")
    chi = result["after"]["chi"]
    require(result["before"]["chi"]["fitted"] > result["before"]["chi"]["null_fitted"] and chi["held_out"] <= 1.05 * chi["null_held_out"], f"held-out chi {result['before']['chi']['held_out']:.2f} -> {chi['held_out']:.2f}, null {chi['null_held_out']:.2f}")
    for name in ("first strip", "second strip", "bars"):
        require((folder / "all" / name / "report.html").exists(), f"the page of the {name}")
    require("<title>first strip: " in (folder / "all/first strip/report.html").read_text(), "which says whose it is")
    own = json.loads((folder / "all/first strip/result.json").read_text())
    page = (folder / "all/first strip/report.html").read_text()
    require(page.count("data:image/png") == 6 and own["remainder"]["map"]["largest"] < 2 * own["remainder"]["map"]["limit"], "with its residual on the surface")
    require(next(one for one in own["before"]["candidates"] if one["name"] == "force gain")["tried"]["achieved_drop"] > 0, "and what its trial achieved")
    page = (folder / "all/report.html").read_text()
    require("Error of each frame" in page and "frames of all tests" in page and "forces and stresses" in page, "the page of all has the frames of all")
    require(own["named"] == ["force gain"] and own["after"]["parameters"]["E"] == found["E"], "the first strip's own page says it in its own terms")

    left_behind(folder / "all", folder / "all.yaml", "loop", ("loop/first_frames", "loop/tests"), xdmf=False)
    left_behind(folder / "all/second strip", folder / "second.yaml", None, ("loop/after/force",))
    same_page(program, folder / "all")
    same_page(program, folder / "all/bars")
    figures(folder / "all", ["chi.png", "first strip/residual.png", "bars/curves.png"])

    plan = run(program, "check", folder / "all.yaml", 2)
    require(plan.count("candidates at most") == 3 and "Two strips and bars: 3 tests" in plan, "check says what would be run of each test")
    for name, old, new in (("first", "thickness: 2.2857142857", "thickness: -1"), ("second", "E: 190e3", "E: 191e3"), ("bars", "bars/*.csv", "none/*.csv")):
        (folder / f"wrong_{name}.yaml").write_text((folder / f"{name}.yaml").read_text().replace(old, new))
    case = folder / "wrong.yaml"
    case.write_text(ALL.replace("first.yaml", "wrong_first.yaml").replace("bars.yaml", "wrong_bars.yaml"))
    said = run(program, "check", case, 1, status=2, errors=True)
    require("specimen.thickness: -1" in said and 'no file "none/*.csv"' in said, f"mistakes of two tests at once: {said.strip()}")
    case.write_text(ALL.replace("second.yaml", "wrong_second.yaml"))
    require("material.parameters.E: 191000 free; allowed: 190000 free as in" in run(program, "check", case, 1, status=2, errors=True), "a law is declared alike in all tests")
    (folder / "wrong_second.yaml").write_text((folder / "second.yaml").read_text().replace("E: 190e3", "E: {value: 190e3, lower: 150e3}"))
    said = run(program, "check", case, 1, status=2, errors=True)
    require("material.parameters.E: 190000 free, from 150000; allowed: 190000 free as in" in said, f"its bounds, too: {said.strip()}")
    case.write_text(ALL.replace("additions: 2", "additions: 2, prior: {E: 1000}"))
    require("loop.prior: given beside tests" in run(program, "check", case, 1, status=2, errors=True), "priors are the cases' own")
    case.write_text(ALL.replace("additions: 2", "additions: 2, leave_out: [nonsense]"))
    require("loop.leave_out: nonsense" in run(program, "check", case, 1, status=2, errors=True), "and what no test can leave out")

    (folder / "in_kN.yaml").write_text((folder / "second.yaml").read_text().replace("second/loads.csv", "second/in_kN.csv"))
    with open(folder / "second/in_kN.csv", "w") as file:
        for number, line in enumerate((folder / "second/loads.csv").read_text().splitlines()):
            frame, time, force = line.split(",")
            print(frame, time, force if number == 0 else f"{1e-3 * float(force):.6f}", sep=",", file=file)
    case.write_text(ALL.replace("second.yaml", "in_kN.yaml"))
    said = run(program, "loop", case, ranks_of(sys.argv), status=2, errors=True)
    require("in_kN.yaml: loads.force: 0.001" in said, f"whose force is a thousandth of what the law gives: {said.strip()}")

    case = folder / "twice.yaml"
    case.write_text(ALL.replace("second strip", "first strip").replace("second.yaml", "none.yaml") + "material: {law: elastic}\n")
    said = run(program, "loop", case, 1, status=2, errors=True)
    require(all(word in said for word in ("once more", "no such file", "given beside tests")), "mistakes of the list of tests")
    case.write_text(ALL.replace("second.yaml", "none.yaml").replace("first.yaml", "wrong_first.yaml"))
    said = run(program, "check", case, 1, status=2, errors=True)
    require("no such file" in said and "specimen.thickness: -1" in said, f"mistakes of the list and of its cases at once: {said.strip()}")
    for name in ("../elsewhere", "..", '""'):
        case.write_text(ALL.replace("name: second strip", f"name: {name}"))
        said = run(program, "loop", case, 1, status=2, errors=True)
        require("a name that a folder can have" in said, f"a test is not called {name}: {said.strip()}")
    case.write_text(ALL.replace("second.yaml", "first.yaml"))
    said = run(program, "loop", case, 1, status=2, errors=True)
    require("the case of first strip once more" in said, f"the same case twice: {said.strip()}")
    identified_together(program, folder)
    end()


def identified_together(program, folder):
    """`imic3d identify` of the same tests: it tells that something is left, and looks for nothing; with the gain declared as known nothing is."""
    tests = ALL.replace("output: all", "output: NAME")
    (folder / "gained.yaml").write_text((folder / "first.yaml").read_text() + f"effects: {{force_gain: {{force_gain: {GAIN}}}}}\n")
    for name, first in (("lacking", "first"), ("complete", "gained")):
        (folder / f"{name}.yaml").write_text(tests.replace("NAME", name).replace("first.yaml", f"{first}.yaml"))
        said = run(program, "identify", folder / f"{name}.yaml", ranks_of(sys.argv))
        result, page = json.loads((folder / name / "result.json").read_text()), (folder / name / "report.html").read_text()
        chi = result["after"]["chi"]
        require((chi["fitted"] > chi["null_fitted"]) == (name == "lacking") and ("Something is missing" in said) == (name == "lacking"), f"{name}: chi {chi['fitted']:.2f}, null {chi['null_fitted']:.2f}")
        require(not result["rounds"] and not result["after"]["candidates"] and not result["searched"] and "no effect was looked for" in said.lower(), "no effect is looked for")
        require("Candidates" not in page and "<th>before" not in page and "Identified alone" in page and "What this test cannot see" not in page, "nor does the page speak of any")
        require(result["parameters"] == result["after"]["parameters"] and result["covariance"]["parameters"] == ["E", "nu"], "parameters and covariance as of other identifications")
        same_page(program, folder / name)
        one = result["parameters"]["E"]
    require(abs(one["value"] - fields.E) < 4 * one["standard_deviation"] < 0.004 * fields.E, f"E {one['value']:.0f} +- {one['standard_deviation']:.0f}, true {fields.E:.0f}")
    (folder / "one.yaml").write_text((folder / "second.yaml").read_text().replace("second/run", "second/identified"))
    said = run(program, "identify", folder / "one.yaml", ranks_of(sys.argv))
    result = json.loads((folder / "second/identified/result.json").read_text())
    one = result["parameters"]["E"]
    require("The model leaves what noise leaves" in said and "+- " in said and abs(one["value"] - fields.E) < 4 * one["standard_deviation"], f"one test of displacement fields: E {one['value']:.0f} +- {one['standard_deviation']:.0f}")


main()
