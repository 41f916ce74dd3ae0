#!/usr/bin/python3
"""Blind trials of `imic3d loop` on displacement fields with force: CalculiX pulls a thin plate with a hole between grips (quadratic
bricks, a finer mesh and a longer specimen than is declared), the displacement is sampled at points as a subset correlation would give it, noise and
rounding are added, and something is done to the test that the case file does not declare. imic3d has to say what is missing.

tools/blind_fields.py [--reduced] [--seeds N] [--nulls N] [--only NAME,NAME] [--out FOLDER] [--imic3d PROGRAM]

Sizes are multiples of the smallest detectable one (MDE), which the first test without any effect reports. Writes FOLDER/trials.csv (one line a
trial), FOLDER/table.md and prints the table. A trial whose result is there is not run again."""

import argparse
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import blind
import calculix as cx
from calculix_virtual import STATIC, combine, newton, shape, simulate

LAW = cx.Law()
TRUTH = dict(E=LAW.E, S_y=LAW.S_y, H=LAW.H, delta=LAW.delta)
FRAMES, STRAIN, REST = 16, 4.0, 4
# A plate of half a millimetre is no plane stress at the hole's edge: 27 standard deviations of all points together, which the loop sees.
THICKNESS = 0.1
NOISE, LOAD_NOISE, STEP, SUBSET = 2e-3, 2.0, 0.5, 0.3  # of a point [mm], of the load cell [N]; of the points [mm]
DECLARED = {
    "power": ("power_linear, tie_initial_modulus: true", "E: 190e3, nu: {nu}, S_y: 278, H: 1420, delta: 0.042", "E, S_y, H, delta"),
    "linear": ("linear", "E: 190e3, nu: {nu}, S_y: 400, H: 1400", "E, S_y, H"),
}


def plate(radius=2.5):
    return cx.Plate(length=40.0, thickness=THICKNESS, radius=radius, around=12, outward=14, along=7, through=1)


class Generator:
    """The plate's front face in every frame, for each hole; simulated once."""

    def __init__(self, folder):
        self.folder, self.known = folder, {}

    def __call__(self, radius=2.5, nu=LAW.nu):
        if (radius, nu) not in self.known:
            options = SimpleNamespace(strain=STRAIN, frames=FRAMES, theory="hencky", increment=0.05)
            name = f"radius_{radius:.5f}_nu_{nu:.5f}"
            self.known[radius, nu] = simulate(options, cx.Law(nu=nu), self.folder / name, plate(radius))
        return self.known[radius, nu]


def sampled(nodes, faces, moved, at):
    """The face's displacement (frames, n, 3) at points (m, 2) of the undeformed plate, the mean over a subset: (frames, m, 3); NaN off it."""
    result = np.zeros((len(moved), len(at), 3))
    offsets = SUBSET * np.linspace(-1 / 3, 1 / 3, 3)
    for dx in offsets:
        for dy in offsets:
            places, values = at + [dx, dy], np.full((len(moved), len(at), 3), np.nan)
            for face in faces:
                corners = nodes[face]
                near = np.flatnonzero(np.all((places > corners.min(0) - 0.05) & (places < corners.max(0) + 0.05), axis=1))
                if len(near) == 0:
                    continue
                xi, eta = newton(corners, places[near, 0], places[near, 1], np.zeros(len(near)), np.zeros(len(near)), 12)
                inside = (np.abs(xi) < 1 + 1e-9) & (np.abs(eta) < 1 + 1e-9)
                N, _, _ = shape(xi[inside], eta[inside])
                for k in range(3):
                    values[:, near[inside], k] = combine(N, moved[:, face, k].T[:, :, None])
            result += values / 9
    return result


def make(folder, generator, planted, seed):
    """Points, loads and case file of one trial."""
    p = dict(force_offset=0.0, force_gain=1.0, force_delay=0.0, magnification_drift=0.0, inverse_distance=0.0, k1=0.0, bump=0.0, preload=0.0, hole_radius_error=0.0,
             nu=LAW.nu, declared="power", mesh=(1.0, 2.5), oscillation=0.0, debonded=0.0, jumps=0.0) | planted
    random = np.random.default_rng(seed)
    nodes, faces, moved, force = generator(2.5 + p["hole_radius_error"], p["nu"])
    moved, force = moved[STATIC:], force[STATIC:]
    x, y = np.meshgrid(np.arange(-9.5, 9.51, STEP), np.arange(-12.5, 12.51, STEP))
    at = np.column_stack([x.ravel(), y.ravel()])
    at = at[np.hypot(at[:, 0], at[:, 1]) > 2.5 + 0.4 + max(0.0, p["hole_radius_error"])]
    u = sampled(nodes, faces, moved, at)
    if np.isnan(u).any():
        sys.exit(f"{folder}: points off the plate")
    # The record, before anything was set to zero; time 0 is the reference, frame k is at time k.
    time = np.arange(FRAMES + 1.0)
    true = np.concatenate([[0.0], force])
    record = np.interp(time - p["force_delay"], time, true) * p["force_gain"] + p["force_offset"]
    u = np.concatenate([np.zeros((1, len(at), 3)), u])
    if p["preload"]:
        # The reference was taken under load, in the elastic range: displacement and record count from there.
        k = 3
        share = p["preload"] / true[k]
        u, record = u - share * u[k], record - p["preload"]
        record[0], u[0] = 0.0, 0.0
    seen = at + u[:, :, :2]
    # What the camera makes of it, about the optical axis in the middle of the points.
    middle = 0.5 * (at.min(0) + at.max(0))
    clock = time / time[-1]
    for t in range(1, FRAMES + 1):
        r = seen[t] - middle
        growth = p["magnification_drift"] * clock[t] + p["oscillation"] * np.sin(2 * np.pi * 2.5 * clock[t]) + p["bump"] * (t > FRAMES // 2)
        growth = growth + p["inverse_distance"] * u[t, :, 2] + p["k1"] * np.sum(r**2, axis=1)
        seen[t] = seen[t] + (growth[:, None] if np.ndim(growth) else growth) * r
    if p["k1"]:  # the reference is distorted too: points are where they are seen
        r = at - middle
        seen[1:] -= p["k1"] * np.sum(r**2, axis=1)[:, None] * r
    d = seen[1:] - at
    if p["debonded"]:  # paint that no longer follows: out of the library
        patch = np.hypot(at[:, 0] - 5, at[:, 1] - 5) < 1.8
        for t in range(FRAMES // 2, FRAMES):
            d[t, patch] = d[FRAMES // 2 - 1, patch] + (1 - p["debonded"]) * (d[t, patch] - d[FRAMES // 2 - 1, patch])
    record = record[1:] + p["jumps"] * random.choice([-1.0, 1.0], FRAMES) * (np.arange(FRAMES) % 3 == 0)
    folder.mkdir(parents=True, exist_ok=True)
    common = random.normal(size=(len(at), 2)) * NOISE  # of the reference
    rest = np.zeros((REST, len(at), 2))
    for number, field in enumerate(np.concatenate([rest, d]), 1):
        noisy = np.round(field + common + random.normal(size=field.shape) * NOISE, 5)
        np.savetxt(folder / f"points_{number:03}.csv", np.column_stack([at, noisy]), delimiter=",", header="x,y,u,v", comments="", fmt="%.6g")
    force = np.concatenate([np.full(REST, p["force_offset"]), record]) + random.normal(size=REST + FRAMES) * LOAD_NOISE
    rows = [f"{n},{max(0, n - REST)},{f:.4f}" for n, f in enumerate(force, 1)]
    (folder / "loads.csv").write_text("frame,time,force\n" + "\n".join(rows) + "\n")
    hole, far = p["mesh"]
    sizes = [a for key, value in (("length", 24), ("size_hole", hole), ("size_far", far)) for a in ("-setnumber", key, str(value))]
    subprocess.run(["gmsh", "-2", "-v", "1", *sizes, "-format", "msh41", Path(__file__).parent / "meshes/plate_with_hole.geo", "-o", folder / "mesh.msh"], check=True)
    hardening, parameters, free = DECLARED[p["declared"]]
    (folder / "case.yaml").write_text(f"""title: blind trial on fields
specimen: {{mesh: mesh.msh, kinematics: plane_stress, element: quad8, thickness: {THICKNESS}, held: bottom, loaded: top}}
fields: {{files: points_*.csv, subset: {SUBSET}, at_rest: 1-{REST}}}
loads: {{file: loads.csv, image: frame, time: time, force: force, noise: {LOAD_NOISE}}}
material: {{law: j2, hardening: {hardening}, parameters: {{{parameters.format(nu=LAW.nu)}}}}}
identify: {{functional: displacement_driven, stages: [{{free: [{free}]}}]}}
loop: {{draws: 60, additions: 2, rivals: 3, starts: [1.0]}}
output: run
""")


# name in the library: (parameter of the generator, an engineer's size, largest that is planted)
EFFECTS = {
    "force zero": ("force_offset", 6.0, 60.0),
    "delay of the force": ("force_delay", 0.2, 1.5),
    "magnification drift": ("magnification_drift", 5e-4, 1e-2),
    "parallax": ("inverse_distance", 5e-3, 5e-2),
    "lens distortion": ("k1", 2e-5, 1e-3),
    "camera bump": ("bump", 3e-4, 1e-2),
    "preload": ("preload", 20.0, 120.0),
    "hole radius": ("hole_radius_error", 0.1, 0.4),
    "Poisson's ratio": ("nu", 0.28, 0.40),
}
NULLS = {"nu": LAW.nu, "force_gain": 1.0}
FOUND_AS = {"bump": "step_of_magnification"}
OUTSIDE = {"oscillating magnification": dict(oscillation=1e-3), "debonded patch": dict(debonded=0.5), "force jumps": dict(jumps=5.0)}
OTHERS = {"power_term": dict(declared="linear"), "coarse mesh": dict(mesh=(3.5, 6.0))}
PAIRS = [("force zero", "parallax"), ("hole radius", "magnification drift")]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reduced", action="store_true", help="one null, force zero, parallax and the paper's pair of laws; fails where a verdict is wrong")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--nulls", type=int, default=10)
    parser.add_argument("--multiples", default="1,3,10,50")
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path, default=Path("runs/blind_fields"))
    parser.add_argument("--imic3d", default="build/release/imic3d")
    options = parser.parse_args()
    generator = Generator(options.out / "calculix")
    suite = blind.Suite(options.out, options.imic3d, lambda folder, planted, seed: make(folder, generator, planted, seed), TRUTH)
    only = set(filter(None, options.only.split(",")))
    wanted = lambda name: not only or name in only

    first = None
    for seed in range(1 if options.reduced else options.nulls):
        result = suite.trial("null", "-", "0", {}, 1000 + seed)
        first = first or result
        if only:
            break
    detectable = {one["name"]: one["sizes"][0]["detectable"] for one in first["before"]["candidates"]} if first else {}
    # the third quantity of the bump is the step of magnification, that of the generator
    for one in first["before"]["candidates"] if first else []:
        for size in one["sizes"]:
            if size["parameter"] == "step_of_magnification":
                detectable[one["name"]] = size["detectable"]
    if options.reduced:
        for name in ("force zero", "parallax"):
            parameter, _, _ = EFFECTS[name]
            suite.trial("effect", name, "10", {parameter: NULLS.get(parameter, 0.0) + 10 * detectable[name]}, 1, FOUND_AS.get(parameter, parameter))
        suite.trial("effect", "power_term", "-", OTHERS["power_term"], 1)
    else:
        for name, (parameter, usual, largest) in EFFECTS.items():
            null = NULLS.get(parameter, 0.0)
            sizes = {k: null + float(k) * detectable[name] for k in options.multiples.split(",") if name in detectable} | {"usual": usual}
            for multiple, size in sizes.items():
                for seed in range(options.seeds if wanted(name) and abs(size) <= largest else 0):
                    suite.trial("effect", name, multiple, {parameter: size}, 1 + seed, FOUND_AS.get(parameter, parameter))
        for name, planted in OTHERS.items():
            for seed in range(options.seeds if wanted(name) else 0):
                suite.trial("effect", name, "-", planted, 1 + seed)
        for name, planted in OUTSIDE.items():
            for seed in range(options.seeds if wanted(name) else 0):
                suite.trial("outside", name, "-", planted, 100 + seed)
        for pair in PAIRS:
            for seed in range(options.seeds if wanted(" + ".join(pair)) else 0):
                suite.trial("pair", " + ".join(pair), "-", {EFFECTS[n][0]: EFFECTS[n][1] for n in pair}, 200 + seed)
    suite.report()
    if options.reduced:
        suite.fail_unless_right()


if __name__ == "__main__":
    main()
