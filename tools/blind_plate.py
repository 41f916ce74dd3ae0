#!/usr/bin/python3
"""Blind trials of `imic3d loop` on a plate with a hole that CalculiX pulls between grips (thin; quadratic bricks, a finer mesh and a longer specimen than is
declared). Something is done to the test that the case file does not declare, and imic3d has to say what is missing.

images   a speckle of discs given by formulas, mapped back sample by sample, averaged over the pixels, with noise, in 8 bits: 250 x 320 px
fields   the displacement at points as a subset correlation would give it, with noise, rounded

tools/blind_plate.py {images,fields} [--reduced] [--waist] [--by imic3d] [--seeds N] [--nulls N] [--only NAME,NAME] [--bricks N,N,N] [--grey-noise N] [--noise N] [--theory simo] [--frames N] [--mesh HOLE,FAR] [--out FOLDER] [--imic3d PROGRAM]
tools/blind_plate.py {images,fields} --together [...]
tools/blind_plate.py images --identify [...]

--together: three plates of one material in one loop; the load cell of the first reads 6 % too much, which none of them shows alone. Fails unless that is named.

--identify: `imic3d identify` on tests in which nothing is missing, as by default and as it was before (steps_per_frame: 1, noise_draws: 0): what the parameters are off by, and in their standard deviations.

--by imic3d: pulled by `imic3d simulate` instead (a finer mesh, a longer specimen, 16 increments a frame; no motion out of plane), which tells what the loop errs by from what the two programs' laws differ by.

Each effect at 10 x MDE is planted once more and left out of the candidates. Sizes are multiples of the smallest detectable one (MDE), which the first test without any effect reports. Writes FOLDER/trials.csv (one line a
trial), FOLDER/table.md and prints the table. A trial whose result is there is not run again."""

import argparse
import io
import json
import shutil
import subprocess
import sys
import zlib
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
from PIL import Image

import blind
import calculix as cx
from calculix_virtual import STATIC, combine, newton, picture, shape, simulate, speckle, strains

LAW = cx.Law()
TRUTH = dict(E=LAW.E, S_y=LAW.S_y, H=LAW.H, delta=LAW.delta)
FRAMES, STRAIN, REST = 16, 4.0, 4
LENGTH, DECLARED_LENGTH = 40.0, 24.0  # [mm]
# A plate of half a millimetre is no plane stress at the hole's edge: 27 standard deviations of all points together, which the loop sees; one of a millimetre is among the trials.
THICKNESS, RADIUS = 0.1, 2.5
LOAD_NOISE = 2.0  # [N]
NOISE, STEP, SUBSET = 2e-3, 0.5, 0.3  # of a point, step and subset of the points [mm]
PIXEL, WIDTH, HEIGHT, GREY_NOISE = 0.09, 250, 320, 2.0  # [mm], [px], [grey levels]
DECLARED = {
    "power": ("power_linear, tie_initial_modulus: true", "E: 190e3, nu: {nu}, S_y: 278, H: 1420, delta: 0.042", "E, S_y, H, delta"),
    "linear": ("linear", "E: 190e3, nu: {nu}, S_y: 400, H: 1400", "E, S_y, H"),
}
# What the generator can do to a test. Lengths in mm, forces in N, times in frames; `mesh`: declared sizes at the hole and far from it.
NOTHING = dict(force_offset=0.0, force_gain=1.0, force_delay=0.0, preload=0.0, jumps=0.0, hole_radius_error=0.0, nu=LAW.nu, magnification_drift=0.0, drift_with_load=0.0, inverse_distance=0.0, k1=0.0, tilt=0.0,
               bump=0.0, oscillation=0.0, debonded=0.0, dropped=0, duplicated=0, black=0.0, white=255.0, jpeg=0, declared_noise=0.0, force_unit=1.0, true_thickness=THICKNESS, thickness=THICKNESS, declared="power", mesh=None, leave_out=[])


def waisted(points):
    """The points (n, 2 or 3) of the plate, those of one with a waist: three quarters as wide at the hole, which is elliptical then."""
    return np.column_stack([points[:, 0] * (1 - 0.25 * np.exp(-(points[:, 1] / 6) ** 2)), points[:, 1:]])


class Waisted(cx.Plate):
    def mesh(self):
        nodes, cells = super().mesh()
        return waisted(nodes), cells


class Generator:
    """The plate's front face in every frame, for each hole, Poisson's ratio and thickness: nodes (n, 2), faces (m, 8), displacement (FRAMES + 1, n, 3), force (FRAMES + 1); simulated once."""

    def __init__(self, folder, bricks, increment, waist, program=None, theory="hencky"):
        self.folder, self.bricks, self.increment, self.waist, self.program, self.theory = folder, bricks, increment, waist, program, theory

    def __call__(self, radius, nu, thickness=THICKNESS):
        thick, other = thickness != THICKNESS, self.theory != "hencky"
        file = self.folder / (f"radius_{radius:.5f}_nu_{nu:.5f}" + f"_thickness_{thickness:g}" * thick + f"_{self.theory}" * other + ".npz")
        if not file.exists() and self.program:
            np.savez(file, **self.by_imic3d(radius, nu, file.with_suffix("")))
        elif not file.exists():
            around, outward, along = self.bricks
            plate = (Waisted if self.waist else cx.Plate)(length=LENGTH, thickness=thickness, radius=radius, around=around, outward=outward, along=along, through=2 if thick else 1)
            result = simulate(SimpleNamespace(strain=STRAIN, frames=FRAMES, theory=self.theory, increment=self.increment), cx.Law(nu=nu), file.with_suffix(""), plate)
            np.savez(file, **dict(zip(("nodes", "faces", "displacement", "force"), result)))
        known = np.load(file)
        return known["nodes"], known["faces"], known["displacement"][STATIC - 1:], known["force"][STATIC - 1:]

    def declared_mesh(self, path, kind, sizes):
        hole, far = sizes or ((1.2, 2.0) if self.waist else {"images": (1.6, 4.0), "fields": (1.0, 2.5)}[kind])  # elements of 4 mm miss the waist by 0.1 mm
        make_mesh(path, self.waist, length=DECLARED_LENGTH, size_hole=hole, size_far=far)

    def by_imic3d(self, radius, nu, folder):
        folder.mkdir(parents=True, exist_ok=True)
        make_mesh(folder / "mesh.msh", self.waist, length=LENGTH, diameter=2 * radius, size_hole=0.35, size_far=0.7)
        parameters = ", ".join(f"{name}: {value!r}" for name, value in {**TRUTH, "nu": nu}.items())
        elongation = (LENGTH * strains(SimpleNamespace(strain=STRAIN, frames=FRAMES))).tolist()
        (folder / "case.yaml").write_text(f"""title: blind trial
specimen: {{mesh: mesh.msh, kinematics: plane_stress, element: quad8, thickness: {THICKNESS}, held: bottom, loaded: top}}
material: {{law: j2, hardening: power_linear, tie_initial_modulus: true, parameters: {{{parameters}}}}}
simulate: {{clamped: true, centred: true, steps_per_frame: 16, value: {[0.0, *elongation]}}}
output: run
""")
        subprocess.run([Path(self.program).resolve(), "simulate", folder / "case.yaml"], check=True, capture_output=True)
        with h5py.File(folder / "run/results.h5") as file:
            U, force = file["fields/displacement"][1:], file["frames/force_predicted"][1:]
            return dict(nodes=file["mesh/nodes"][:, :2], faces=file["mesh/cells"][:], displacement=np.concatenate([np.zeros((STATIC, *U.shape[1:])), U]), force=np.concatenate([np.zeros(STATIC), force]))


def test(generator, p, random):
    """The test as it is recorded, the reference first: nodes (n, 2), faces (m, 8), the nodes where the camera sees them (FRAMES + 1, n, 2), force (FRAMES + 1)."""
    nodes, faces, u, force = generator(RADIUS + p["hole_radius_error"], p["nu"], p["true_thickness"])
    time = np.arange(FRAMES + 1.0)
    record = np.interp(time - p["force_delay"], time, force) * p["force_gain"] + p["force_offset"]
    if p["preload"]:
        # The reference was taken under load, in the elastic range: record and displacement count from there.
        share = p["preload"] / force[3]
        u, record = u - share * u[3], record - p["preload"]
        record[0], u[0] = p["force_offset"], 0.0
    record[1:] += p["jumps"] * random.choice([-1.0, 1.0], FRAMES) * (np.arange(FRAMES) % 3 == 0)
    clock = time / time[-1]
    growth = p["magnification_drift"] * clock + p["drift_with_load"] * force / force.max() + p["oscillation"] * np.sin(2 * np.pi * 2.5 * clock) + p["bump"] * (time > FRAMES // 2)
    at = nodes + u[:, :, :2]
    seen = at * (1.0 + growth[:, None, None] + p["inverse_distance"] * u[:, :, 2:] + p["k1"] * np.sum(at**2, axis=2, keepdims=True)) / (1.0 - p["tilt"] * at[:, :, :1])
    if p["debonded"]:  # paint that no longer follows
        patch, last = np.hypot(nodes[:, 0] - 5, nodes[:, 1] - 5) < 1.8, FRAMES // 2
        seen[last + 1:, patch] = seen[last, patch] + (1 - p["debonded"]) * (seen[last + 1:, patch] - seen[last, patch])
    return nodes, faces, seen, record


def sampled(nodes, faces, values, at):
    """Fields (frames, n, k) of the face at points (m, 2) of the undeformed plate, the mean over a subset: (frames, m, k); NaN off it."""
    result = np.zeros((len(values), len(at), values.shape[2]))
    offsets = SUBSET * np.linspace(-1 / 3, 1 / 3, 3)
    for dx in offsets:
        for dy in offsets:
            places, found = at + [dx, dy], np.full(result.shape, np.nan)
            for face in faces:
                corners = nodes[face]
                near = np.flatnonzero(np.all((places > corners.min(0) - 0.05) & (places < corners.max(0) + 0.05), axis=1))
                if len(near) == 0:
                    continue
                xi, eta = newton(corners, places[near, 0], places[near, 1], np.zeros(len(near)), np.zeros(len(near)), 12)
                inside = (np.abs(xi) < 1 + 1e-9) & (np.abs(eta) < 1 + 1e-9)
                N, _, _ = shape(xi[inside], eta[inside])
                for k in range(result.shape[2]):
                    found[:, near[inside], k] = combine(N, values[:, face, k].T[:, :, None])
            result += found / 9
    return result


def points(folder, nodes, faces, seen, p, seed, random):
    """Tables of points; what the case file says of them."""
    x, y = np.meshgrid(np.arange(-9.5, 9.51, STEP), np.arange(-12.5, 12.51, STEP))
    at = np.column_stack([x.ravel(), y.ravel()])
    at = at[np.hypot(at[:, 0], at[:, 1]) > RADIUS + 0.4 + max(0.0, p["hole_radius_error"])]
    # A correlation's points are those of the reference image, in which the camera shows X beside its place.
    material = at - sampled(nodes, faces, seen[:1] - nodes, at)[0]
    u = sampled(nodes, faces, seen[1:] - seen[0], material)
    if np.isnan(u).any():
        sys.exit(f"{folder}: points off the plate")
    common = random.normal(size=at.shape) * NOISE  # of the reference
    for number, field in enumerate(np.concatenate([np.zeros((REST,) + at.shape), u]), 1):
        noisy = np.round(field + common + random.normal(size=at.shape) * NOISE, 5)
        np.savetxt(folder / f"points_{number:03}.csv", np.column_stack([at, noisy]), delimiter=",", header="x,y,u,v", comments="", fmt="%.6g")
    return f"fields: {{files: points_*.csv, subset: {SUBSET}, at_rest: 1-{REST}}}"


def pictures(folder, nodes, faces, seen, p, seed, random):
    """Images; what the case file says of them. Those without noise are kept for other tests of the same speckle in which the camera sees the same."""
    known = folder.parent / "pictures" / f"{zlib.crc32(np.round(seen, 9).tobytes()):08x}_{seed}.npy"
    if not known.exists():
        options = SimpleNamespace(width=WIDTH, height=HEIGHT, pixel=PIXEL, samples=2)
        discs = speckle(options, np.random.default_rng(seed))
        clean = [picture(nodes, faces, moved, discs, options)[0] for moved in seen]
        known.parent.mkdir(parents=True, exist_ok=True)
        np.save(known, np.array(clean, np.float32))
    clean = np.load(known)
    shutil.rmtree(folder / "images", ignore_errors=True)
    (folder / "images").mkdir()
    frames = [0] * REST + list(range(1, FRAMES + 1))
    if p["dropped"]:  # an image that was not written: those after it have numbers one too small
        del frames[REST - 1 + p["dropped"]]
    if p["duplicated"]:  # an image that was written twice, in the place of the next
        frames[REST + p["duplicated"]] = p["duplicated"]
    for number, frame in enumerate(frames):
        grey = Image.fromarray(np.clip(np.rint(clean[frame] + random.normal(size=clean[frame].shape) * GREY_NOISE), p["black"], p["white"]).astype(np.uint8))
        if p["jpeg"]:
            grey.save(packed := io.BytesIO(), "JPEG", quality=p["jpeg"])
            grey = Image.open(packed)
        grey.save(folder / f"images/frame_{number:03}.png")
    noise = f", noise: {p['declared_noise']}" if p["declared_noise"] else ""
    return f"cameras: [{{name: front, pixel_size: {PIXEL}, place: {{origin: [{(WIDTH - 1) / 2}, {(HEIGHT - 1) / 2}]}}, images: \"images/*.png\", reference: 0-{REST - 1}{noise}}}]"


def gmsh(geometry, path, order=1, **numbers):
    """A mesh of tools/meshes in Gmsh's format 2.2."""
    sizes = [text for key, value in numbers.items() for text in ("-setnumber", key, str(value))]
    subprocess.run(["gmsh", "-2", "-order", str(order), "-v", "1", *sizes, "-format", "msh22", Path(__file__).parent / f"meshes/{geometry}.geo", "-o", path], check=True)


def make_mesh(path, waist, **numbers):
    """Of the plate."""
    gmsh("plate_with_hole", path, **numbers)
    if not waist:
        return
    lines = path.read_text().splitlines()
    first = lines.index("$Nodes") + 2
    for i in range(first, lines.index("$EndNodes")):
        number, *at = lines[i].split()
        lines[i] = " ".join([number, *map(repr, waisted(np.array([at], float))[0].tolist())])
    path.write_text("\n".join(lines) + "\n")


def make(kind, generator, folder, planted, seed):
    """Data, record and case file of one trial. The speckle is the seed's, noise is the trial's."""
    p = NOTHING | planted
    random = np.random.default_rng([seed, zlib.crc32(folder.name.encode())])
    folder.mkdir(parents=True, exist_ok=True)
    nodes, faces, seen, record = test(generator, p, random)
    data = {"images": pictures, "fields": points}[kind](folder, nodes, faces, seen, p, seed, random)
    force = np.concatenate([np.full(REST, record[0]), record[1:]]) + random.normal(size=REST + FRAMES) * LOAD_NOISE
    first = {"images": 0, "fields": 1}[kind]  # number of the first frame
    rows = [f"{first + n},{max(0, n + 1 - REST)},{f / p['force_unit']:.7g}" for n, f in enumerate(force)][:REST + FRAMES - bool(p["dropped"])]
    (folder / "loads.csv").write_text("frame,time,force\n" + "\n".join(rows) + "\n")
    generator.declared_mesh(folder / "mesh.msh", kind, p["mesh"])
    hardening, parameters, free = DECLARED[p["declared"]]
    (folder / "case.yaml").write_text(f"""title: blind trial on {kind}
specimen: {{mesh: mesh.msh, kinematics: plane_stress, element: quad8, thickness: {p["thickness"]}, held: bottom, loaded: top}}
{data}
loads: {{file: loads.csv, image: frame, time: time, force: force, noise: {LOAD_NOISE / p["force_unit"]}}}
material: {{law: j2, hardening: {hardening}, parameters: {{{parameters.format(nu=LAW.nu)}}}}}
identify: {{functional: displacement_driven, stages: [{{free: [{free}]}}]}}
loop: {{draws: 60, additions: 2, rivals: 2, starts: [1.0], leave_out: {json.dumps(p["leave_out"])}}}
output: run
""")


# name in the library: (parameter of the generator, an engineer's size, largest that is planted)
EFFECTS = {
    "force zero": ("force_offset", 6.0, 150.0),
    "delay of the force": ("force_delay", 0.2, 1.5),
    "magnification drift": ("magnification_drift", 5e-4, 1e-2),
    "parallax": ("inverse_distance", 5e-3, 5e-2),
    "lens distortion": ("k1", 2e-5, 1e-3),
    "camera tilt": ("tilt", 2e-4, 5e-3),
    "camera bump": ("bump", 3e-4, 1e-2),
    "preload": ("preload", 20.0, 120.0),
    "hole radius": ("hole_radius_error", 0.1, 0.4),
    "Poisson's ratio": ("nu", 0.28, 0.40),
}
NULLS = {"nu": LAW.nu, "force_gain": 1.0}
FOUND_AS = {"bump": "step_of_magnification", "tilt": "perspective_x"}
OUTSIDE = {"oscillating magnification": dict(oscillation=1e-3), "debonded patch": dict(debonded=0.5), "force jumps": dict(jumps=5.0)}
OTHERS = {"power_term": dict(declared="linear"), "coarse mesh": dict(mesh=(3.5, 6.0))}
THICK = dict(true_thickness=1.0, thickness=1.0)  # nothing is missing, but it is no plane stress at the hole's edge
PAIRS = [("force zero", "lens distortion"), ("hole radius", "magnification drift")]
# Faults of a test that no effect of the library is, on images: any name is a wrong one.
FAULTS = {
    "load cell and thickness by 5 %": dict(force_gain=1.05, thickness=1.05 * THICKNESS),
    "magnification that goes with the load": dict(drift_with_load=1e-3),
    "saturated speckle": dict(white=190.0),
    "speckle cut in the dark": dict(black=40.0),
    "images compressed by JPEG": dict(jpeg=75),
    "an image that is missing": dict(dropped=9),
    "an image that is there twice": dict(duplicated=9),
    "force in kN read as N": dict(force_unit=1000.0),
    "noise declared half as large as it is": dict(declared_noise=0.5 * GREY_NOISE),
}
TOGETHER = {"first": dict(force_gain=1.06), "second": {}, "third": {}}
REDUCED = ["force zero", "magnification drift", "Poisson's ratio"]


def together(kind, generator, folder, program):
    for seed, (name, planted) in enumerate(TOGETHER.items(), 21):
        make(kind, generator, folder / name, planted, seed)
    tests = "".join(f"  - {{name: {name}, case: {name}/case.yaml}}\n" for name in TOGETHER)
    (folder / "all.yaml").write_text(f"title: plates of one material\ntests:\n{tests}loop: {{draws: 60, additions: 2, rivals: 3, starts: [1.0]}}\noutput: all\n")
    shutil.rmtree(folder / "all", ignore_errors=True)
    subprocess.run([Path(program).resolve(), "loop", folder / "all.yaml"], check=True)
    result = json.loads((folder / "all/result.json").read_text())
    chi, found = result["after"]["chi"], result["after"]["parameters"]
    gain = found.get("force_gain (first)", {"value": 1.0, "standard_deviation": 0.0})
    off = {name: f"{100 * (found[name]['value'] / true - 1):+.2f} +- {100 * found[name]['standard_deviation'] / true:.2f} %" for name, true in TRUTH.items()}
    print(f"named {result['named']}, set {result['set']}, gain {gain['value']:.4f} +- {gain['standard_deviation']:.4f}, parameters off by {off}, held-out chi {result['before']['chi']['held_out']:.2f} -> {chi['held_out']:.2f} (null {chi['null_held_out']:.2f})")
    if result["named"] != ["force gain (first)"] or abs(gain["value"] - 1.06) > 4 * gain["standard_deviation"] or chi["held_out"] > 1.05 * chi["null_held_out"]:
        sys.exit("the first load cell was not found")
    for name in TOGETHER:
        own = json.loads((folder / "all" / name / "result.json").read_text())
        if own["named"] != (["force gain"] if name == "first" else []):
            sys.exit(f"the page of the {name} plate names {own['named']}")


def identified(kind, generator, folder, program, nulls):
    """Prints what parameters are off by over tests in which nothing is missing."""
    print("| functional | identify | " + " | ".join(TRUTH) + " |\n|---|---|" + "---|" * len(TRUTH))
    for functional in ("displacement_driven", "force_driven"):
        for name, settings in (("steps_per_frame: 1, noise_draws: 0", "steps_per_frame: 1, noise_draws: 0, "), ("as by default", "")):
            off, deviations = [], []
            for seed in range(1, 1 + nulls):
                its = folder / f"identify_{seed}"
                if not (its / "case.yaml").exists():
                    make(kind, generator, its, {}, seed)
                case = its / f"{functional}_{'default' if not settings else 'before'}.yaml"
                text = (its / "case.yaml").read_text().replace("functional: displacement_driven", f"{settings}functional: {functional}")
                case.write_text(text.replace("output: run", f"output: {case.stem}"))
                subprocess.run([Path(program).resolve(), "identify", case], check=True, capture_output=True)
                found = json.loads((its / case.stem / "result.json").read_text())["parameters"]
                off.append([found[key]["value"] / true - 1 for key, true in TRUTH.items()])
                deviations.append([found[key]["standard_deviation"] / true for key, true in TRUTH.items()])
            mean, each = 100 * np.mean(off, axis=0), np.sqrt(np.mean((np.array(off) / deviations) ** 2, axis=0))
            print(f"| {functional} | {name} | " + " | ".join(f"{m:+.2f} % ({r:.1f})" for m, r in zip(mean, each)) + " |", flush=True)
    print(f"\nMean of {nulls} tests, in brackets rms in units of the standard deviations that are reported.")


def main():
    global GREY_NOISE, NOISE, FRAMES
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("images", "fields"))
    parser.add_argument("--reduced", action="store_true", help="one null and three effects at 10 x MDE (those of --only, all of which must be named; of fields the paper's pair of laws, too), from a coarser simulation; fails where a verdict is wrong")
    parser.add_argument("--waist", action="store_true", help="a plate with a waist and an elliptical hole")
    parser.add_argument("--by", choices=("calculix", "imic3d"), default="calculix")
    parser.add_argument("--theory", choices=("hencky", "simo"), default="hencky", help="of CalculiX: imic3d's, or its own (docs/verification.md)")
    parser.add_argument("--together", action="store_true", help="three plates in one loop")
    parser.add_argument("--identify", action="store_true", help="imic3d identify where nothing is missing")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--nulls", type=int, default=10)
    parser.add_argument("--multiples", default="1,3,10,50")
    parser.add_argument("--only", default="", help="names, with commas between them")
    parser.add_argument("--bricks", help="CalculiX's, of a quarter of the plate: around the hole, outwards, along the rest (12,14,7; reduced 8,9,5)")
    parser.add_argument("--grey-noise", type=float, default=GREY_NOISE, help="of an image [grey levels]")
    parser.add_argument("--noise", type=float, default=NOISE, help="of a point of a field [mm]")
    parser.add_argument("--frames", type=int, default=FRAMES, help="to the same elongation")
    parser.add_argument("--mesh", help="declared sizes of elements at the hole and far from it [mm]")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--imic3d", default="build/release/imic3d")
    options = parser.parse_args()
    given = {"frames": (options.frames, FRAMES), "grey_noise": (options.grey_noise, GREY_NOISE), "noise": (options.noise, NOISE), "mesh": (options.mesh, None), "theory": (options.theory, "hencky")}
    out = options.out or Path("_".join([f"runs/blind_{options.kind}"] + [f"{key}_{value}" for key, (value, usual) in given.items() if value != usual]))
    bricks = options.bricks or ("8,9,5" if options.reduced else "12,14,7")
    GREY_NOISE, NOISE, FRAMES = options.grey_noise, options.noise, options.frames
    if options.mesh:
        NOTHING["mesh"] = tuple(float(size) for size in options.mesh.split(","))
    generator = Generator(out / options.by, [int(n) for n in bricks.split(",")], 0.1 if options.reduced else 0.05, options.waist, options.imic3d if options.by == "imic3d" else None, options.theory)
    suite = blind.Suite(out, options.imic3d, lambda folder, planted, seed: make(options.kind, generator, folder, planted, seed), TRUTH)
    if options.identify and options.kind != "images":
        parser.error("--identify: images")
    if options.identify:
        identified(options.kind, generator, out, options.imic3d, options.nulls)
        return
    if options.together:
        together(options.kind, generator, out, options.imic3d)
        return
    only = set(filter(None, options.only.split(",")))
    wanted = lambda name: not only or name in only
    seeds = lambda name: range(options.seeds if wanted(name) else 0)

    first = None
    for seed in range(1 if options.reduced or only else options.nulls):
        result = suite.trial("null", "-", "0", {}, 1 + seed)
        first = first or result
    if first is None:
        sys.exit("the program failed without any effect: see log.txt")
    # of the bump the step of magnification, which is the generator's
    its_size = lambda one: next((size for size in one["sizes"] if size["parameter"] in FOUND_AS.values()), one["sizes"][0])
    detectable = {one["name"]: size for one in first["before"]["candidates"] if (size := its_size(one)["detectable"])}
    for name, (parameter, usual, largest) in EFFECTS.items():
        if options.reduced and name not in REDUCED:
            continue
        null = NULLS.get(parameter, 0.0)
        multiples = ["10"] if options.reduced else options.multiples.split(",")
        sizes = {k: null + float(k) * detectable[name] for k in multiples if name in detectable} | ({} if options.reduced else {"usual": usual})
        for multiple, size in sizes.items():
            for seed in seeds(name) if abs(size) <= largest else []:
                suite.trial("effect", name, multiple, {parameter: size}, 1 + seed, FOUND_AS.get(parameter, parameter))
                if multiple == "10" and not options.reduced:
                    suite.trial("without", name, "-", {parameter: size, "leave_out": [name]}, 50 + seed)
    for seed in seeds("thick plate") if not options.reduced and options.by == "calculix" else []:
        suite.trial("null", "thick plate", "-", THICK, 1 + seed)
    for name, planted in OTHERS.items():
        for seed in seeds(name) if not options.reduced or (name == "power_term" and options.kind == "fields") else []:
            suite.trial("effect", name, "-", planted, 1 + seed)
    if options.kind == "images" and not options.reduced:
        for name, planted in FAULTS.items():
            for seed in seeds(name):
                suite.trial("fault", name, "-", planted, 1 + seed)
    if not options.reduced:
        for name, planted in OUTSIDE.items():
            for seed in seeds(name):
                suite.trial("outside", name, "-", planted, 1 + seed)
        for pair in PAIRS:
            for seed in seeds(" + ".join(pair)):
                at_ten = {EFFECTS[n][0]: min(10.0 * detectable[n], EFFECTS[n][2]) for n in pair}
                suite.trial("pair", " + ".join(pair), "10", at_ten, 1 + seed)
    suite.report()
    if options.reduced:
        suite.fail_unless_right(0 if only else 1)


if __name__ == "__main__":
    main()
