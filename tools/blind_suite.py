#!/usr/bin/python3
"""Blind trials of `imic3d loop` on stress-strain curves: bars of a material are made by a program of its own (one-dimensional
plasticity, integrated in small implicit steps; nothing of imic3d), with an effect that the case file does not declare, bars that
differ, noise and rounding; imic3d has to say what is missing. Sizes are multiples of the smallest detectable one (MDE), which a
test without any effect reports.

tools/blind_suite.py [--reduced] [--seeds N] [--nulls N] [--only EFFECT ...] [--out FOLDER] [--imic3d PROGRAM]

Writes FOLDER/trials.csv (one line a trial), FOLDER/table.md and prints the table."""

import argparse
import math
import zlib
from pathlib import Path

import numpy as np

import blind

TRUTH = dict(E=200e3, S_y=250.0, S_inf=420.0, b=18.0, H=700.0)
DEFAULT = dict(C_1=0.0, gamma_1=50.0, C_rate=0.0, rate_0=1e-3, eta=0.0, m=0.3, heating=0.0, cooling=0.0, Q_v=0.0, b_v=150.0, eps_L=0.0,
               damage=0.0, eps_D=0.0, force_offset=0.0, force_delay=0.0, gain=1.0, friction=0.0, strain_gain=1.0, compliance=0.0, strain_offset=0.0,
               ageing=0.0, slip=0.0, twinning=0.0)


def integrate(time, strain, p):
    """Axial Kirchhoff stress at the rows of a bar: logarithmic strain prescribed, virgin at row 0."""
    eps_p, q, X, work, stress = 0.0, 0.0, 0.0, 0.0, [0.0]
    step = 2e-5 if p["C_rate"] or p["eta"] else 4e-4  # where flow sets in the rate jumps
    for i in range(1, len(strain)):
        n = max(1, int(math.ceil(abs(strain[i] - strain[i - 1]) / step)))
        de, dt = (strain[i] - strain[i - 1]) / n, (time[i] - time[i - 1]) / n
        for k in range(1, n + 1):
            eps = strain[i - 1] + k * de

            def state(dp, sign):
                X1 = (X + p["C_1"] * dp * sign) / (1.0 + p["gamma_1"] * dp)
                w1 = (work + abs(p["E"] * (eps - eps_p - sign * dp)) * dp) / (1.0 + p["cooling"] * dt)
                qq = q + dp
                s = max(0.0, qq - p["eps_L"])
                y = p["S_y"] + (p["S_inf"] - p["S_y"]) * (1.0 - math.exp(-p["b"] * s)) + p["H"] * s + p["Q_v"] * (1.0 - math.exp(-p["b_v"] * qq))
                y += p["twinning"] * math.sin(2.0 * math.pi * qq / 0.02)  # out of the library: waves of hardening
                rate = dp / dt if dt > 0 else 0.0
                y *= (1.0 + p["C_rate"] * math.log1p(rate / p["rate_0"])) * (1.0 - p["heating"] * w1)
                y += p["eta"] * rate ** p["m"] if rate > 0 else 0.0
                return X1, w1, y

            trial = p["E"] * (eps - eps_p)
            sign = 1.0 if trial - X >= 0 else -1.0

            def gap(dp):
                X1, w1, y = state(dp, sign)
                return sign * (trial - p["E"] * sign * dp - X1) - y

            if gap(0.0) > 0.0:
                low, high = 0.0, abs(de) + abs(trial) / p["E"]
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    if gap(middle) > 0.0:
                        low = middle
                    else:
                        high = middle
                dp = 0.5 * (low + high)
                X, work, _ = state(dp, sign)
                eps_p += sign * dp
                q += dp
            else:
                work /= 1.0 + p["cooling"] * dt
        stress.append(p["E"] * (strain[i] - eps_p) * math.exp(-p["damage"] * max(0.0, q - p["eps_D"])))
    return np.array(stress)


def groups():
    """Name, bars, rate, turning points of the logarithmic strain."""
    return [("slow", 6, 1e-4, [0.12]), ("middle", 5, 1e-2, [0.12]), ("fast", 5, 10.0, [0.12]), ("cycles", 4, 1e-3, [0.015, -0.015, 0.015, -0.015, 0.02])]


def history(rate, turns, rows):
    """Time and strain of a bar at its rows and at the turning points, which it goes to between them, too; which of these are rows."""
    path = np.concatenate([[0.0], turns])
    length = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path)))])
    recorded = np.linspace(0.0, 1.0, rows) ** (1.0 if len(turns) > 1 else 1.5) * length[-1]
    along = np.union1d(recorded, length)
    return along / rate, np.interp(along, length, path), np.isin(along, recorded)


def make(folder, effect, seed):
    """The curves and the case file of one trial, with noise of its own."""
    random = np.random.default_rng([seed, zlib.crc32(folder.name.encode())])
    folder.mkdir(parents=True, exist_ok=True)
    leave_out, declare = effect.get("leave_out", []), effect.get("declare", {})
    p = TRUTH | DEFAULT | {name: value for name, value in effect.items() if name not in ("leave_out", "declare")}
    sizes, shapes = [next(iter(its)) for its in declare.values()], {name: value for its in declare.values() for name, value in its.items()}
    lines = ["title: blind trial", "units: {length: mm, force: N, time: s}",
             f"material: {{law: j2, hardening: voce, effects: [{', '.join(declare)}], parameters: {{{', '.join(f'{name}: {value}' for name, value in shapes.items())}{',' if shapes else ''} "
             "E: {value: 200e3, lower: 150e3, upper: 250e3}, nu: 0.3, S_y: {value: 230, lower: 50, upper: 900},"
             " S_inf: {value: 450, lower: 50, upper: 1500}, b: {value: 14, lower: 0.5, upper: 300}, H: {value: 600, lower: 0, upper: 5000}}}", "experiments:"]
    everywhere = p
    for name, bars, rate, turns in groups():
        files = []
        p = everywhere | {key.removesuffix(f" of {name}"): value for key, value in everywhere.items() if key.endswith(f" of {name}")}
        for bar in range(bars):
            time, strain, recorded = history(rate, turns, 120 if len(turns) == 1 else 200)
            true = strain / p["strain_gain"]
            stress = integrate(time, true, p)
            engineering = stress * np.exp(-true)
            x = np.abs(np.diff(strain, prepend=0.0)).cumsum()
            x = 2.0 * x / x[-1] - 1.0
            c = random.normal(size=3) * [5.0, 3.0, 2.0]  # bars differ [MPa]
            engineering = engineering + (c[0] + c[1] * x + c[2] * 0.5 * (3 * x * x - 1)) * np.minimum(1.0, np.abs(engineering) / 200.0)
            strain = np.log(np.exp(strain) + p["compliance"] * engineering + p["strain_offset"])  # the bar goes through its history, the load train's share is recorded, too
            engineering = engineering + p["ageing"] * np.sin(2 * np.pi * time / time[-1] * 7)  # out of the library: a hum
            engineering = engineering + p["slip"] * (strain > 0.06) * (1 if bar % 2 else -1)    # out of the library: jumps of either sign
            engineering = engineering + p["friction"] * np.sign(np.diff(strain, prepend=-1e-9))
            engineering = np.interp(time - p["force_delay"], time, engineering) * p["gain"] + p["force_offset"]
            time, strain, engineering = time[recorded], strain[recorded], engineering[recorded]
            engineering = np.round(engineering + random.normal(size=len(time)) * 2.0, 1)
            file = folder / f"{name}_{bar}.csv"
            np.savetxt(file, np.column_stack([time, np.round(np.expm1(strain), 6), engineering]), delimiter=",", header="time,strain,stress", comments="", fmt="%.9g")
            files.append(file.name)
        lines.append(f"  - {{name: {name}, file: [{', '.join(files)}], time: time, strain: strain, stress: stress, from: 0.0005}}")
    lines += [f"identify: {{stages: [{{free: [{', '.join(['E', 'S_y', 'S_inf', 'b', 'H'] + sizes)}]}}]}}", f"loop: {{rivals: 3, additions: 2, starts: [1.0, 0.9], leave_out: {leave_out}}}", "output: run"]
    (folder / "case.yaml").write_text("\n".join(lines) + "\n")


# name in the library: (parameter of the generator, shapes, engineering size, largest that is planted)
EFFECTS = {
    "rate": ("C_rate", dict(rate_0=1e-3), 0.01, 0.1),
    "viscosity": ("eta", dict(m=0.3), 10.0, 100.0),
    "heating": ("heating", dict(cooling=0.0), 1e-3, 6e-3),
    "kinematic": ("C_1", dict(gamma_1=50.0), 3000.0, 2e4),
    "voce_term": ("Q_v", dict(b_v=150.0), 40.0, 200.0),
    "plateau": ("eps_L", {}, 0.01, 0.05),
    "damage": ("damage", dict(eps_D=0.0), 1.0, 5.0),
    "force zero": ("force_offset", {}, 8.0, 100.0),
    "friction": ("friction", {}, 8.0, 100.0),
    "delay of the force": ("force_delay", {}, 1e-4, 2e-3),
    "strain gain": ("strain_gain", {}, 1.03, 1.3),
    "compliance": ("compliance", {}, 1e-6, 1e-5),
    "strain zero": ("strain_offset", {}, 1e-4, 3e-3),
    "gain of fast": ("gain of fast", {}, 1.05, 1.5),
    "force zero of fast": ("force_offset of fast", {}, 8.0, 100.0),
    "strain gain of fast": ("strain_gain of fast", {}, 1.03, 1.3),
    "compliance of fast": ("compliance of fast", {}, 1e-6, 1e-5),
}
OUTSIDE = {"hum": dict(ageing=12.0), "waves of hardening": dict(twinning=12.0), "jumps": dict(slip=15.0)}
PAIRS = [("rate", "force zero"), ("kinematic", "damage"), ("gain of fast", "kinematic"), ("delay of the force", "rate")]
REDUCED = ["rate", "kinematic", "force zero"]
NULLS = {"strain_gain": 1.0, "gain": 1.0}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--reduced", action="store_true", help="three effects, one seed, 10 x MDE, two nulls, one outside the library; fails where a verdict is wrong")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--nulls", type=int, default=20)
    parser.add_argument("--only", nargs="+", choices=[*EFFECTS, "left out", "pairs", "outside"], help="these effects and kinds of trials alone")
    parser.add_argument("--out", default="runs/blind_suite")
    parser.add_argument("--imic3d", default="build/release/imic3d")
    options = parser.parse_args()
    suite = blind.Suite(Path(options.out), options.imic3d, make, TRUTH)

    # Nulls, and from the first the smallest detectable sizes. With the shapes that are planted, where these are not the usual ones: from the standard deviation
    # of the size, declared as one more unknown.
    detectable = {}
    for seed in range(2 if options.reduced else options.nulls):
        result = suite.trial("null", "-", "0", {}, 1000 + seed)
        if seed == 0 and result:
            detectable = {one["name"]: size for one in result["before"]["candidates"] if (size := one["sizes"][0]["detectable"])}
            for name, (parameter, shapes, _, _) in EFFECTS.items():
                if shapes and (not options.reduced or name in REDUCED) and (not options.only or name in options.only or {"left out", "pairs"} & set(options.only)):
                    with_it = suite.run(suite.folder / f"declared_{name}", {"declare": {name: {parameter: 0.0} | shapes}}, 1000)
                    if with_it:
                        detectable[name] = (result["before"]["threshold"] + 0.9) * with_it["before"]["parameters"][parameter]["standard_deviation"]

    def planted(effect, multiple):
        parameter, shapes, usual, _ = EFFECTS[effect]
        return {parameter: usual if multiple == "usual" else NULLS.get(parameter.removesuffix(" of fast"), 0.0) + multiple * detectable[effect]} | shapes

    wanted = lambda what: not options.only or what in options.only
    effects = [effect for effect in (REDUCED if options.reduced else EFFECTS) if wanted(effect)]
    for effect in effects:
        parameter, _, _, largest = EFFECTS[effect]
        # No multiples where no size would be found.
        for multiple in [k for k in ((10,) if options.reduced else (1, 3, 10, 50)) if effect in detectable] + ([] if options.reduced else ["usual"]):
            its = planted(effect, multiple)
            for seed in range(0 if its[parameter] > largest else 1 if options.reduced else options.seeds):
                suite.trial("effect", effect, str(multiple), its, 1 + seed, parameter.replace(" ", "_"))
    if not options.reduced:
        at_ten = {effect: planted(effect, 10) for effect in EFFECTS if effect in detectable}
        at_ten = {effect: its for effect, its in at_ten.items() if its[EFFECTS[effect][0]] <= EFFECTS[effect][3]}
        for effect, its in at_ten.items():
            for seed in range(options.seeds if wanted("left out") else 0):
                suite.trial("without", effect, "-", its | {"leave_out": [effect]}, 50 + seed)
        for pair in PAIRS:
            for seed in range(options.seeds if wanted("pairs") and set(pair) <= set(at_ten) else 0):
                suite.trial("pair", " + ".join(pair), "-", at_ten[pair[0]] | at_ten[pair[1]], 200 + seed)
    for name, its in list(OUTSIDE.items())[2 if options.reduced else 0:]:
        for seed in range(0 if not wanted("outside") else 1 if options.reduced else options.seeds):
            suite.trial("outside", name, "-", its, 100 + seed)
    suite.report()
    if options.reduced:
        suite.fail_unless_right()


if __name__ == "__main__":
    main()
