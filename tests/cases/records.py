#!/usr/bin/python3
"""Records of bars as laboratories hand them in: what is unlikely in one is doubted before anything is identified, once, and nothing in a good one; bars in
compression scatter as those in tension do; times in another unit.

Usage: records.py EXECUTABLE
"""
import json
import sys

import numpy

from runs import end, require, run, workspace

E, S_Y, H, RATE, NOISE = 200e3, 300.0, 2000.0, 1e-3, 1.0
CASE = """
title: Bars
material: {{hardening: linear, parameters: {{E: {E}, nu: 0.3, S_y: {S_y}, H: 1500}}}}
experiments: [{{name: bars, file: "{name}/*.csv", time: time{more}}}]
identify: {{stages: [{{free: [E, S_y, H]}}]}}
output: {name}/run
"""


def bar(seed, stronger=1.0):
    """Time, engineering strain, engineering stress: elastic, then straight hardening in true stress and strain."""
    random = numpy.random.default_rng(seed)
    true = numpy.concatenate([numpy.linspace(0, 3e-3, 60), numpy.linspace(3.2e-3, 0.05, 235)])
    stress = stronger * numpy.where(true < S_Y / E, E * true, S_Y + (true - S_Y / E) * E * H / (E + H))
    return true / RATE, numpy.expm1(true), stress * numpy.exp(-true) + random.normal(size=true.size) * NOISE


def main():
    program, folder = sys.argv[1], workspace("records")

    def write(name, change, more="", values=(190e3, 280), count=3, stronger=(1.0, 0.99, 1.012)):
        (folder / name).mkdir()
        for k in range(count):
            columns = change(*bar(k + 1, stronger[k]))
            numpy.savetxt(folder / name / f"bar_{k}.csv", numpy.column_stack(columns), delimiter=",", header="time,strain,stress", comments="", fmt="%.9g")
        (folder / f"{name}.yaml").write_text(CASE.format(name=name, more=more, E=values[0], S_y=values[1]))
        return folder / f"{name}.yaml"

    def warned(case):
        return [line for line in run(program, "check", case, errors=True).splitlines() if "warning" in line]

    good = write("good", lambda t, e, s: (t, e, s))
    require(not warned(good), "nothing is doubted of good records")

    def slipped(t, e, s):
        e = e.copy()
        e[200:] += 0.003
        return t, e, s

    first = 30
    for name, change, words in (
        ("tared_under_load", lambda t, e, s: (t[first:], e[first:] - e[first], s[first:]), ("3 of 3 records begin with a stress", "by +30", "strain zero")),
        ("zero", lambda t, e, s: (t, e, s + 20), ("3 of 3 records begin with a stress", "by +2", "force zero")),
        ("slipped", slipped, ("3 of 3 records have a strain that jumps once", "before row 200 by 0.003")),
        ("slipped_by_little", lambda t, e, s: (t, e + 5 * numpy.median(numpy.diff(e)) * (t >= t[200]), s), ("3 of 3 records have a strain that jumps once", "before row 200")),
        ("saturated", lambda t, e, s: (t, e, numpy.minimum(s, 330.0)), ("3 of 3 records have a largest stress that stands", "end of its range")),
        ("twice", lambda t, e, s: (numpy.repeat(t, 2), numpy.repeat(e, 2), numpy.repeat(s, 2)), ("3 of 3 records have rows that repeat", "295 rows")),
    ):
        said = warned(write(name, change))
        require(said and all(any(word in line for line in said) for word in words) and len(said) == 1, f"{name}: {said}")
    refused = run(program, "check", write("turned", lambda t, e, s: (t, e + numpy.random.default_rng(9).normal(size=e.size) * 2e-5, -s)), status=2, errors=True)
    require("a stress that falls where the strain grows" in refused, f"turned round: {refused}")
    said = warned(write("gigapascal", lambda t, e, s: (t, e, s), values=(190, 280)))
    require(any("it would yield at a strain of 1.5" in line for line in said), f"E in GPa: {said}")
    run(program, "identify", folder / "gigapascal.yaml")
    require("it would yield at a strain of 1.5" in (folder / "gigapascal/run/report.html").read_text(), "and on the page")
    few = slice(None, None, 40)  # of which one is elastic
    for name, change, words in (
        ("few", lambda t, e, s: (t[few], e[few], s[few]), None),
        ("few_of_another_unit", lambda t, e, s: (t[few], e[few], s[few] / 1e3), ("the stress first rises by", "force_unit")),
        ("few_in_percent", lambda t, e, s: (t[few], 200 * e[few], s[few]), ("a bar is drawn to", "strain_scale: 0.01")),
        ("few_in_microstrain", lambda t, e, s: (t[few], 1e6 * e[few], s[few]), ("the stress first rises by", "strain_scale")),
    ):
        said = warned(write(name, change))
        require(not said if words is None else len(said) == 1 and all(word in said[0] for word in words), f"{name}: {said}")
    for name, direction in (("along", 0), ("across", 90)):
        case = write(name, lambda t, e, s: (t, e, s), f", direction: {direction}")
        case.write_text(case.read_text().replace("{hardening: linear,", "{hardening: linear, effects: [hill],"))
        said = warned(case)
        require(any("is their direction" in line for line in said) == (direction == 0), f"{name}: {said}")
    refused = run(program, "check", write("one_column", lambda t, e, s: (t, e, s), ", stress: strain"), status=2, errors=True)
    require("stress: strain, which is strain, too; allowed: another column for each" in refused, f"one column for two: {refused}")

    def identified(case):
        run(program, "identify", case)
        result = json.loads((case.parent / case.stem / "run/result.json").read_text())
        return {name: (one["value"], one["standard_deviation"]) for name, one in result["parameters"].items() if one.get("standard_deviation")}, result

    case = write("bounds", lambda t, e, s: (t, e, s))
    case.write_text(case.read_text().replace("H: 1500", "H: {value: 1500, lower: -10}"))
    said = warned(case)
    require(len(said) == 1 and "material.parameters.H: lower -10 lies beyond the law's own bound, 0, which holds" in said[0], f"a bound that the law does not have: {said}")

    # What the law misses of a single bar is in no standard deviation.
    missed = "times what its noise is is left"
    for name, more, beyond in (("alone", 0.0, False), ("waves", 5.0, True)):
        _, result = identified(write(name, lambda t, e, s, more=more: (t, e, s + more * numpy.sin(300.0 * e)), count=1))
        require(any(missed in doubt for doubt in result.get("doubts", [])) == beyond, f"{name}: {result.get('doubts')}")

    # Of less than a thousandth of the declared E no simulation tells anything: there it stops, and says so.
    weak, result = identified(write("weak", lambda t, e, s: (t, e, s / 1e4)))
    require(result["parameters"]["E"]["value"] == 190.0 and result["parameters"]["E"]["on_bound"], f"E on its bound: {result['parameters']['E']}")
    pulled, _ = identified(good)
    pushed, result = identified(write("compression", lambda t, e, s: (t, -e, -s)))
    # Engineering strains of the same size are other true strains: the scatter is the same to a few percent.
    require(all(0.8 < pushed[name][1] / pulled[name][1] < 1.25 for name in pulled), f"bars in compression differ as those in tension do: {pulled} {pushed}")
    once, _ = identified(folder / "twice.yaml")
    require(all(abs(once[name][0] - pulled[name][0]) < 1e-6 * pulled[name][0] and abs(once[name][1] / pulled[name][1] - 1) < 1e-6 for name in pulled), f"rows that are written twice count once: {once}")

    # A law that depends on the rate, and a clock in milliseconds.
    rates = {}
    for name, factor, more in (("seconds", 1.0, ""), ("milliseconds", 1e3, ", time_scale: 0.001")):
        case = write(name, lambda t, e, s, factor=factor: (factor * t, e, s), more)
        case.write_text(case.read_text().replace("hardening: linear,", "hardening: linear, effects: [rate],").replace("nu: 0.3,", "nu: 0.3, C_rate: 0.02, rate_0: 1e-4,"))
        rates[name] = identified(case)[0]
    same = all(abs(rates["milliseconds"][name][0] / value - 1) < 1e-9 for name, (value, _) in rates["seconds"].items())
    require(same and abs(rates["seconds"]["S_y"][0] / pulled["S_y"][0] - 1) > 0.02, f"a clock in milliseconds: {rates}")
    end()


main()
