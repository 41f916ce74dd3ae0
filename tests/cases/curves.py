#!/usr/bin/python3
"""Identification on stress-strain curves: laboratory's files made from a closed form, every way to declare them.

Usage: curves.py EXECUTABLE
"""
import csv
import json
import math
import pathlib
import random
import subprocess
import sys
import tempfile

import h5py
import numpy

from runs import SOURCE, data, end, figures, left_behind, require, run, same_page

E, S_Y, S_INF, B, C, RATE_0 = 200e3, 250.0, 450.0, 12.0, 0.02, 1e-3
KSI = 6.894757293168


def bar(file, speed, seed, noise=2.0, rows=150):
    """sigma = (S_inf - (S_inf - S_y) exp(-b p)) (1 + C ln(1 + p'/rate_0)) at a constant p', as engineering stress in ksi and strain in
    per cent, with a line before the header; rows after the largest force, where the bar necks, fall as no material point does."""
    draw = random.Random(seed)
    strength = 1 + 0.002 * draw.gauss(0, 1)
    lines = ["{'temperature': 297}", "clock; strain_%; stress_ksi"]
    for i in range(rows):
        p = 1.5e-3 * i
        stress = 0.0 if i == 0 else strength * (S_INF - (S_INF - S_Y) * math.exp(-B * p)) * (1 + C * math.log(1 + speed / RATE_0))
        strain = 0.0 if i == 0 else p + stress / E
        engineering = stress * math.exp(-strain) + noise * draw.gauss(0, 1) * (i > 0)
        lines.append(f"{p / speed}; {100 * math.expm1(strain)}; {engineering / KSI}")
    lines += [f"{(p + 0.01 * k) / speed}; {100 * math.expm1(strain + 0.01 * k)}; {engineering / KSI * (1 - 0.2 * k)}" for k in range(1, 4)]
    file.write_text("\n".join(lines) + "\n")


CASE = """
title: Bars
material:
  hardening: voce
  effects: [{effects}]
  parameters: {{E: 200e3, nu: 0.3, S_y: 200, S_inf: 500, b: 20, H: 0{more}}}
experiments:
  - {{name: slow, file: "slow_*.csv", {columns}}}
  - {{name: slow held out, file: slower.csv, {columns}, noise: 3, held_out: true}}
  - {{name: fast, file: [fast_0.csv, fast_1.csv], {columns}, held_out: "70-152"}}
identify:
  stages: [{{free: [S_y, S_inf, b{free}]}}]
output: {output}
"""
COLUMNS = 'time: clock, strain: "strain_%", strain_scale: 0.01, stress: stress_ksi, stress_unit: ksi, from: 0.003, until: maximum_force'


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        for i in range(3):
            bar(folder / f"slow_{i}.csv", 1e-3, i)
        bar(folder / "slower.csv", 2e-3, 7)
        for i in range(2):
            bar(folder / f"fast_{i}.csv", 10.0, 10 + i)

        def identify(name, effects, more, free, ranks=1):
            case = folder / f"{name}.yaml"
            case.write_text(CASE.format(effects=effects, more=more, free=free, columns=COLUMNS, output=name))
            run(program, "identify", case, ranks)
            return json.loads((folder / name / "result.json").read_text())

        declared = identify("declared", "", "", ", nu")
        nu = declared["parameters"]["nu"]
        matrix = numpy.array(declared["covariance"]["values"])
        deviations = [declared["parameters"][name]["standard_deviation"] for name in declared["covariance"]["parameters"]]
        require(sorted(declared["covariance"]["parameters"]) == ["S_inf", "S_y", "b"] and numpy.allclose(numpy.sqrt(matrix.diagonal()), deviations) and numpy.abs(matrix - numpy.diag(matrix.diagonal())).max() > 0, "the covariance of what is determined")
        require(nu["value"] == 0.3 and nu["standard_deviation"] is None and any("nu is not determined" in doubt for doubt in declared["doubts"]), "what bars do not show stays as it is declared, and is doubted")
        rate = identify("rate", "rate", ", C_rate: {value: 0, lower: 0, upper: 0.1}, rate_0: 1e-3", ", C_rate", 2)
        beyond = {name: [doubt for doubt in one.get("doubts", []) if "are left (rms), where its bars differ by" in doubt] for name, one in (("declared", declared), ("rate", rate))}
        require(beyond["declared"] and not beyond["rate"], f"bars at two rates under a law without are doubted: {beyond}")
        # The same bars as force and extension, each with its own section; in a machine that records a pull as negative, too.
        sections, worst = [10.0, 12.5, 20.0], 0.0
        for sign, keys in ((1, "force_unit: kN, extension_unit: um"), (-1, "stress_scale: -1e3, strain_scale: -1e-3")):
            for i, section in enumerate(sections):
                numbers = [[float(field) for field in row.split(";")] for row in (folder / f"slow_{i}.csv").read_text().splitlines()[2:]]
                (folder / f"pulled_{i}.csv").write_text("s; F; dL\n" + "".join(f"{t!r}; {sign * stress * KSI * section / 1e3!r}; {sign * strain / 100 * 25e3!r}\n" for t, strain, stress in numbers))
            case = folder / "pulled.yaml"
            case.write_text(CASE.format(effects="", more="", free=", nu", columns=COLUMNS, output="pulled").replace(
                f'file: "slow_*.csv", {COLUMNS}', f'file: "pulled_*.csv", time: s, force: F, section: {sections}, extension: dL, gauge_length: 25, {keys}, from: 0.003, until: maximum_force'))
            run(program, "identify", case)
            found = json.loads((folder / "pulled/result.json").read_text())["parameters"]
            worst = max([worst] + [abs(found[name]["value"] / declared["parameters"][name]["value"] - 1) for name in ("S_y", "S_inf", "b")])
        require(worst < 1e-9, f"bars as force over section and extension over gauge length are the same ({worst:.1e})")
        null = identify("unused", "kinematic, hill, heating", "", "")
        worst = max(abs(null["parameters"][name]["value"] / declared["parameters"][name]["value"] - 1) for name in ("S_y", "S_inf", "b"))
        require(worst < 1e-6 and null["parameters"]["C_1"]["value"] == 0 and not null["parameters"]["C_1"]["free"],
                f"effects whose parameters are not given change nothing ({worst:.1e})")
        print(run(program, "check", folder / "rate.yaml"))
        of = lambda result, name, use: result["experiments"][name][use]["rms"]["value"]
        require(of(declared, "fast", "held_out") > 15, f"without the rate the fast bars' held-out rows are missed: {of(declared, 'fast', 'held_out'):.1f} MPa")
        require(of(rate, "fast", "held_out") < 6, f"with it they are met: {of(rate, 'fast', 'held_out'):.1f} MPa (bars scatter by {rate['experiments']['fast']['scatter_between_repetitions']['value']:.1f})")
        require(of(rate, "slow held out", "held_out") < 8, f"and so is the bar that was not fitted: {of(rate, 'slow held out', 'held_out'):.1f} MPa")
        for name, truth in (("S_y", S_Y), ("S_inf", S_INF), ("b", B), ("C_rate", C)):
            p = rate["parameters"][name]
            require(abs(p["value"] - truth) < 4 * max(p["standard_deviation"], p["standard_deviation_noise_alone"]) and p["standard_deviation"] < 0.15 * truth,
                    f"{name} {p['value']:.4g} +- {p['standard_deviation']:.2g}, true {truth}")
        require(rate["experiments"]["slow held out"]["standard_deviation_from"] == "given" and rate["experiments"]["slow"]["standard_deviation_from"] == "repetitions",
                "the noise is given or read from the repetitions")
        with open(folder / "rate" / "curves.csv", newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["experiment"] == "fast" and row["curve"] == "fast_0"]
        require(100 < len(rows) <= 150, f"rows after the largest force are left out ({len(rows)} of 153)")
        require({row["use"] for row in rows} == {"not judged", "fitted", "held out"}, "every row says what it was used for")
        page = (folder / "rate" / "report.html").read_text()
        require("C_rate" in page and page.count("<svg") >= 6, "the report has its tables and pictures")

        left_behind(folder / "rate", folder / "rate.yaml", "identify", ("curves/0000/predicted", "identification/values"), xdmf=False)

        said = run(program, "report", folder / "rate", status=2, errors=True)
        require("nothing that a page is made of" in said, f"an identification on curves has its page once: {said.splitlines()[0]}")

        case = folder / "loop.yaml"
        case.write_text(CASE.format(effects="", more="", free=", nu", columns=COLUMNS, output="loop") + "loop: {draws: 20, additions: 1, rivals: 1, starts: [1.0]}\n")
        print(run(program, "check", case))
        run(program, "loop", case, 2)
        left_behind(folder / "loop", case, "loop", ("curves/0005/after", "loop/frame_names"), xdmf=False)
        same_page(program, folder / "loop")
        found = json.loads((folder / "loop/result.json").read_text())
        require(found["after"]["parameters"]["nu"]["standard_deviation"] is None and "These data do not show nu." in found["sentence"] and "not seen" in (folder / "loop/report.html").read_text(),
                "the loop says that bars do not show Poisson's ratio")
        figures(folder / "loop", ["chi.png", "curves.png"])

        # A unit that was forgotten: the stress rises by 1/100 of E. The identification that starts there stops on bounds or does not end, and says so.
        strains = [2e-4 * i for i in range(6)] + [0.002 + 1e-3 * i for i in range(40)]
        draw = random.Random(5)
        rows = [f"{i}; {100 * strain}; {min(E * strain, 250 + 2000 * strain) + draw.gauss(0, 1)}" for i, strain in enumerate(strains)]
        for scale, doubted, left in ((0.01, False, rows), (1, True, rows), (1, True, rows[::2])):  # of every other row two lie below 30 % of the largest stress
            (folder / "percent.csv").write_text("clock; strain; stress\n" + "\n".join(left) + "\n")
            case = folder / "percent.yaml"
            case.write_text("title: bar\nmaterial: {hardening: linear, parameters: {E: 190e3, nu: 0.3, S_y: 230, H: 1500}}\n"
                            f"experiments: [{{name: bar, file: percent.csv, time: clock, strain: strain, stress: stress, strain_scale: {scale}}}]\n"
                            "identify: {stages: [{free: [E, S_y, H]}]}\noutput: percent\n")
            said = run(program, "check", case, errors=True)
            require(("strain in percent (strain_scale: 0.01)" in said) == doubted, f"strain in per cent, strain_scale {scale}: {'doubted' if doubted else 'not doubted'}")
        clockless = folder / "clockless.yaml"
        for clock, doubted in (("", True), ("rate: 1e-3, ", False)):
            clockless.write_text("title: bar\nmaterial: {hardening: linear, effects: [rate], parameters: {E: 190e3, nu: 0.3, S_y: 230, H: 1500, C_rate: 0.01, rate_0: 1e-3}}\n"
                            f"experiments: [{{name: bar, file: percent.csv, {clock}strain: strain, stress: stress, strain_scale: 0.01}}]\nidentify: {{stages: [{{free: [E, S_y, H]}}]}}\noutput: clockless\n")
            require(("neither time nor rate is given" in run(program, "check", clockless, errors=True)) == doubted, f"a law of the rate, {clock or 'no clock'}: {'doubted' if doubted else 'not doubted'}")
        # In compression the largest force is the most negative one; what comes after it is left out.
        (folder / "compressed.csv").write_text("clock; strain; stress\ns; mm/mm; MPa\n" + "\n".join(f"{i}; {-strain}; {-min(E * strain, 250 + 2000 * strain) - draw.gauss(0, 1)}" for i, strain in enumerate(strains)) + "\n100; -0.05; -20\n101; -0.06; -10\n")
        compressed = folder / "compressed.yaml"
        compressed.write_text(case.read_text().replace("strain_scale: 1", "until: maximum_force").replace("percent", "compressed"))
        run(program, "identify", compressed)
        found, rows_left = json.loads((folder / "compressed/result.json").read_text()), len((folder / "compressed/curves.csv").read_text().splitlines()) - 1
        require(rows_left == len(strains) and abs(found["parameters"]["S_y"]["value"] / 250 - 1) < 0.03 and found["experiments"]["bar"]["standard_deviation_of_strain"]["value"] == 0,
                f"a bar in compression up to its largest force: {rows_left} of {len(strains) + 2} rows, S_y {found['parameters']['S_y']['value']:.1f} MPa")
        # A clock of whole seconds beside rows that are four to a second: they follow one another.
        rows_then = [f"{i // 4}; {-strain}; {-min(E * strain, 250 + 2000 * strain) - draw.gauss(0, 1)}" for i, strain in enumerate(strains)]
        (folder / "compressed.csv").write_text("clock; strain; stress\n" + "\n".join(rows_then) + "\n")
        said = run(program, "identify", compressed, errors=True)
        with h5py.File(folder / "compressed/results.h5") as file:
            times = file["curves/0000/time"][:]
        require(f"{len(strains) - (len(strains) + 3) // 4} of {len(strains)} rows have the time of the row before" in said and max(abs(time - i / 4) for i, time in enumerate(times)) < 1e-9, f"rows of one second follow one another ({times[:6]})")
        # A bar that breaks is doubted, unless it is told up to its largest force, and not one that is unloaded.
        farthest, flow, broken = strains[-1], min(E * strains[-1], 250 + 2000 * strains[-1]), "as of a bar that has broken"
        pulled = [f"{i}; {strain}; {min(E * strain, 250 + 2000 * strain) + draw.gauss(0, 1)}" for i, strain in enumerate(strains)]
        breaks = [f"{len(strains) + k}; {farthest + 1e-5 + 1e-3 * k}; {draw.gauss(0, 1)}" for k in range(8)]
        unloads = [f"{len(strains) + k}; {farthest - flow / E * k / 8}; {flow * (1 - k / 8) + draw.gauss(0, 1)}" for k in range(1, 9)]
        told = compressed.read_text()
        to_the_end = told.replace(", until: maximum_force", "")
        for rows_then, case_then, doubted in ((breaks, told, False), (breaks, to_the_end, True), (unloads, to_the_end, False), (unloads, to_the_end.replace("time: clock", "monotonic: true, time: clock"), False)):
            (folder / "compressed.csv").write_text("clock; strain; stress\n" + "\n".join(pulled + rows_then) + "\n")
            compressed.write_text(case_then)
            require((broken in run(program, "check", compressed, errors=True)) == doubted, f"a bar that {'breaks' if rows_then is breaks else 'is unloaded'}: {'doubted' if doubted else 'not doubted'}")
            if doubted:
                run(program, "identify", compressed)
                with open(folder / "compressed/curves.csv", newline="") as file:
                    uses = [row["use"] for row in csv.DictReader(file)]
                require(uses[-9:] == ["fitted"] + 8 * ["not judged"], f"what it does then is not judged ({uses[-9:]})")
        (folder / "percent.csv").write_text("clock; strain; stress\n" + "\n".join(rows) + "\n")
        case.write_text(case.read_text().replace("strain_scale: 1", "strain_scale: 0.01").replace("identify: {", "identify: {max_iterations: 1, "))
        said = run(program, "identify", case, status=3, errors=True)
        result = json.loads((folder / "percent/result.json").read_text())
        require("did not converge" in said and any("did not converge" in doubt for doubt in result["doubts"]) and "Doubted" in (folder / "percent/report.html").read_text(),
                "a stage that does not converge is doubted and ends with status 3, its results written")

        def mistake(change, expected, command="check"):
            case = folder / "bad.yaml"
            case.write_text(change(CASE.format(effects="rate", more="", free="", columns=COLUMNS, output="bad")))
            done = subprocess.run([program, command, str(case)], capture_output=True, text=True)
            require(done.returncode == 2 and expected in done.stderr, f"{expected!r} is said ({done.stderr.strip()[:200]})")

        mistake(lambda s: s.replace("slow_*.csv", "slaw_*.csv"), 'experiments[0].file: no file "slaw_*.csv"')
        mistake(lambda s: s.replace("clock,", "klock,"), 'column "klock": not there; allowed: one of "clock", "strain_%", "stress_ksi"')
        as_force = lambda more: lambda s: s.replace('strain: "strain_%", strain_scale: 0.01, stress: stress_ksi, stress_unit: ksi', more, 1)
        mistake(as_force("force: F, extension: dL, gauge_length: 25"), "experiments[0].section: not given; allowed: what the force is divided by")
        mistake(as_force("force: F, section: 10, stress: stress_ksi"), "experiments[0].stress: given beside force; allowed: one of the two")
        mistake(as_force("stress: stress_ksi, section: 10, strain: \"strain_%\""), "experiments[0].section: given without force; allowed: only with it")
        mistake(as_force("force: stress_ksi, section: [10, 12], strain: \"strain_%\""), "experiments[0].section: 2 numbers; allowed: one, or one for each of the 3 files")
        mistake(as_force("force: stress_ksi, section: 10, force_unit: kN, stress_scale: 2, strain: \"strain_%\""), "experiments[0].stress_scale: given beside force_unit; allowed: one of the two")
        mistake(as_force("force: stress_ksi, section: [10, 0, 1], strain: \"strain_%\""), "experiments[0].section[1]: 0; allowed: a positive number")
        mistake(lambda s: s.replace("[rate]", "[rates]"), 'material.effects[0]: "rates"; allowed: kinematic, ')
        mistake(lambda s: s.replace("b: 20, H: 0", "b: 20, H: 0, Crate: 1"), "near to C_rate")
        mistake(lambda s: s.replace("experiments:", "unknown:"), "specimen: not given; allowed: a section specimen, or experiments")
        mistake(lambda s: s.replace("name: fast", "name: slow"), "a name that no other experiment has")
        mistake(lambda s: s.replace("free: [S_y", 'frames: "1-5", free: [S_y'), "identify.stages[0].frames: given for experiments; allowed: from, until and held_out")
        mistake(lambda s: s.replace("identify:\n", "identify:\n  functional: combined\n"), "identify.functional: given for experiments")
        mistake(lambda s: s.replace("from: 0.003", "from: 5"), "experiments.slow slow_0: from: 5, which no row reaches; allowed: a strain below the bar's largest, 0.")
        mistake(lambda s: s.replace('"70-152"', '"70-9000"'), "experiments[2].held_out: rows 70-9000; allowed: among the rows 0-")
        mistake(lambda s: s.replace('file: "slow_*.csv"', 'file: "slow_*.csv", held_out: true').replace('held_out: "70-152"', "held_out: true"), "experiments: no row to fit: all are held out, or come before `from`")
        mistake(lambda s: s + "loop: {prior: {nu: 0.01}}\n", "loop.prior.nu: of a parameter that is not free", "loop")
        mistake(lambda s: s.replace("stress_unit: ksi", "stress_unit: ksi, noise: -1"), "noise: -1; allowed: a positive number")
        (folder / "few.csv").write_text("strain,stress\n0,0\n0.001,200\n0.002,250\n")
        few = lambda s: s[:s.index("experiments:")] + "experiments: [{name: few, file: few.csv, strain: strain, stress: stress, noise: 1}]\n" + s[s.index("identify:"):]
        (folder / "cycle.csv").write_text("strain,stress\n" + "".join(f"{0.01 * math.sin(k / 10)},{200 * math.sin(k / 10)}\n" for k in range(62)))
        mistake(lambda s: few(s).replace("few.csv,", "cycle.csv, monotonic: true,"), "experiments.few cycle: monotonic, and a strain that goes back by 0.02")
        mistake(few, "experiments: 3 rows to fit, 3 free parameters; allowed: more rows than free parameters", "loop")
        (folder / "signs.csv").write_text("strain,stress\n" + "".join(f"{k / 10000},{-20 * k}\n" for k in range(12)))
        mistake(lambda s: few(s).replace("few.csv", "signs.csv"), "experiments.few signs: a stress that falls where the strain grows; allowed: stress and strain of one sign, both positive in tension; a negative strain_scale or stress_scale turns one", "loop")
        (folder / "copy.csv").write_text((folder / "slow_0.csv").read_text())
        mistake(lambda s: s.replace('"slow_*.csv"', "[slow_0.csv, slow_1.csv, copy.csv]"), "experiments.slow copy: the numbers of slow_0 once more; allowed: bars that were measured, each once", "loop")
        (folder / "commas.csv").write_text("strain,stress\n0,0\n0,001,200,5\n0,002,250,1\n0,003,260,2\n")
        mistake(lambda s: few(s).replace("few.csv", "commas.csv"), "commas.csv:3: 4 fields; allowed: 2 as in the header")
        done = subprocess.run([program, "identify", str(folder / "bad.yaml"), "-resume"], capture_output=True, text=True)
        require(done.returncode == 2 and "with two dashes, --resume" in done.stderr, "an option with one dash instead of two is said")
        (folder / "good.yaml").write_text(CASE.format(effects="rate", more=", C_rate: 0.01", free=", C_rate", columns=COLUMNS, output="file.txt/out"))
        (folder / "file.txt").write_text("")
        done = subprocess.run([program, "check", str(folder / "good.yaml")], capture_output=True, text=True)
        require(done.returncode == 2 and "file.txt is no folder" in done.stderr, f"an output that cannot be made is said by check ({done.stderr.strip()[:200]})")
        mistake(lambda s: s + "effects: {light_gain: {gain_drift: 0.05}}\n", "effects.light_gain", "loop")
        mistake(lambda s: s + "effects: {gain_of_slow: {gain: 3}}\n", "effects.gain_of_slow.gain: 3; allowed: a number from 0.5 to 2 [-]", "loop")
        mistake(lambda s: s + "effects: {gain_of_slaw: {gain: 1.1}}\n", 'effects.gain_of_slaw: no effect "gain_of_slaw", near to gain_of_slow')
        mistake(lambda s: s + "loop: {leave_out: [gain of fast, force zero of slow, nonsense, sence]}\n", 'loop.leave_out: nonsense; allowed: any of ', "loop")
        mistake(lambda s: s + "loop: {leave_out: [gain of fast, nonsense, sence]}\n", 'loop.leave_out: sence; allowed', "loop")

    if data() is None:
        print("skipped  steel304L_rates, steel_cyclic: no folder of measured data (IMIC3D_DATA)")
    else:
        with tempfile.TemporaryDirectory() as temporary:
            results = {}
            for name in ("steel304L_rates/case", "steel304L_rates/rate", "steel_cyclic/case", "steel_cyclic/kinematic_2"):
                case = pathlib.Path(temporary) / (name.replace("/", "_") + ".yaml")
                case.write_text((SOURCE / "inputs" / f"{name}.yaml").read_text().replace("../../runs/data", str(data())))
                run(program, "identify", case, options=["--output", temporary + "/" + name])
                results[name] = json.loads((pathlib.Path(temporary) / name / "result.json").read_text())["experiments"]
            held = lambda name, group: results[name][group]["held_out"]["rms"]["value"]
            before, after = held("steel304L_rates/case", "500 /s, held out"), held("steel304L_rates/rate", "500 /s, held out")
            require(before > 80 and after < 25, f"304L at 500 /s, bars held out: {before:.1f} MPa without the rate, {after:.1f} with it")
            before, after = (results[f"steel_cyclic/{name}"]["cycles"]["held_out"]["typical"]["value"] for name in ("case", "kinematic_2"))
            require(before > 50 and after < 15, f"cyclic steel, cycles held out: {before:.1f} MPa with isotropic hardening, {after:.1f} with back-stresses")
    end()


main()
