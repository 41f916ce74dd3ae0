#!/usr/bin/python3
"""Whole runs as ratios of processor time (user and system, one thread): medians, all sides in one call, taking turns.

Usage: benchmark.py [--only calculix,identification,loop] [--repeats 5] [--loops 1] [--cores 1] [--which TEXT] [--program FILE] [--output FOLDER] [--size-hole 1 --size-far 2.5 --layers 1]

calculix        a direct simulation of the plate with a hole (hex20), with 1, 3 and 4 increments a frame, and CalculiX (C3D20R) on the
                same nodes and elements, with the same ends and frames; it cuts large frames by itself. Its law is the transformed table of
                tools/calculix.py. Accuracy: force (all frames) and displacement (last one) against imic3d with 32 increments a frame.
                With --cores 2: wall time, of two ranks of imic3d and of two threads of CalculiX; wants a machine that does nothing else.
identification  E, S_y, H, delta from 90 % of their values on images of a longer plate with a finer mesh: in four stages of one parameter,
                and all four in one stage; force-driven, and displacement-driven with the reaction in the residual, which is what the
                loop below minimises; all of the program (DIC, report), of the parameters alone (steps_per_frame: 1, noise_draws: 0), as what they are compared with;
                "as by default": with what its increments err by taken off, and with the standard deviations of all noise.
loop            scipy's least_squares calling CalculiX, whose processor time is summed (Python's and the DIC's are left out), from the same
                start, in one stage and in the same four stages, each with the frames that it needs. Data: displacement of the face's nodes
                by `imic3d dic` and the force record. The ends are driven by the DIC's displacement of their nodes, a cubic over the
                width at each frame: what one has of a real test, and what the identification has. Residuals over 1 um (what the DIC of
                the first frames is off by) and 0.1 % of the largest force (the coarse mesh errs by up to 0.07 %). Parameters relative to the
                start, forward differences of 1 %, none after the last step; it ends at a step below 1e-3 of the parameters.
"""
import argparse
import functools
import json
import os
import pathlib
import platform
import re
import resource
import statistics
import subprocess
import sys
import time

import h5py
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

import calculix as cx

ROOT = pathlib.Path(__file__).resolve().parents[1]
TRUTH = {"E": 198e3, "S_y": 284.0, "H": 1480.0, "delta": 0.042}
VALUES = [0.0, 0.027, 0.045, 0.065, 0.082, 0.099, 0.116, 0.133, 0.15, 0.4, 0.69, 0.98, 1.27, 1.56, 1.85]
STATIC = 3
FRAMES = len(VALUES) - 1
PIXEL, IMAGE, LENGTH = 0.06, (384, 640), 34
ONE, FOUR = [([*TRUTH], FRAMES)], [(["E"], 2), (["S_y"], 8), (["H"], FRAMES), (["delta"], FRAMES)]
NOISE_DISPLACEMENT, NOISE_FORCE = 0.001, 0.001  # mm: what the DIC of the first frames is off by; part of the largest force
FINE = 32  # increments a frame of the reference
STEP, DIFFERENCE = 1e-3, 1e-2  # of the parameters: last step, forward differences


def errors(values):
    return ", ".join(f"{name} {100 * (value / TRUTH[name] - 1):+.2f} %" for name, value in zip(TRUTH, values))


class Derivatives:
    """Forward differences, not made anew after the last step: what least_squares simulates without need is left out."""

    def __init__(self, function):
        self.function, self.at = function, None

    def __call__(self, x):
        if self.at is None or np.linalg.norm(x - self.at) > STEP * (STEP + np.linalg.norm(x)):
            self.matrix = np.stack([(self.function(x + DIFFERENCE * e) - self.function(x)) / DIFFERENCE for e in np.eye(len(x))], 1)
            self.at = x.copy()
        return self.matrix


class Benchmark:
    def __init__(self, options):
        self.options, self.folder = options, options.output.resolve()
        self.folder.mkdir(parents=True, exist_ok=True)
        for name, hole, far, length in (("identify", options.size_hole, options.size_far, LENGTH), ("generate", 0.6, 1.6, 46)):
            sizes = [a for key, value in (("length", length), ("size_hole", hole), ("size_far", far)) for a in ("-setnumber", key, str(value))]
            subprocess.run(["gmsh", "-2", "-v", "1", *sizes, "-format", "msh41", ROOT / "tools/meshes/plate_with_hole.geo", "-o", self.folder / f"{name}.msh"], check=True)
        self.times, self.rows, self.ratios = {}, [], []

    def seconds(self, command):
        """Processor time of a command, or wall time on several cores; ends the program if it failed."""
        environment = dict(os.environ, OMP_NUM_THREADS=str(self.options.cores), OPENBLAS_NUM_THREADS="1")
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run([str(c) for c in command], cwd=self.folder, capture_output=True, text=True, env=environment)
        wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode != 0 or "*ERROR" in done.stdout:
            sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
        return wall if self.options.cores > 1 else after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def imic3d(self, *arguments):
        cores = self.options.cores
        ranks = ["mpirun", "-n", cores, "--oversubscribe", "-x", "OMP_NUM_THREADS=1"] if cores > 1 else []
        return self.seconds([*ranks, self.options.program, *arguments])

    def text(self, mesh, layers, parameters):
        values = ", ".join(f"{name}: {value!r}" for name, value in parameters.items())
        return (f"title: Benchmark\nspecimen: {{mesh: {mesh}.msh, element: hex20, layers: {layers}, layer_ratio: 1.6, mid_plane_symmetry: true, thickness: 8.0, held: bottom, loaded: top, axis: y}}\n"
                f"material: {{law: j2, hardening: power_linear, tie_initial_modulus: true, parameters: {{nu: 0.25, {values}}}}}\n")

    def simulate(self, name, increments=1):
        path = self.folder / f"{name}.yaml"
        path.write_text(self.text("identify", self.options.layers, TRUTH) +
                        f"simulate: {{clamped: true, centred: true, steps_per_frame: {increments}, value: {VALUES}}}\noutput: {name}\n")
        spent = self.imic3d("simulate", path.name)
        with h5py.File(self.folder / name / "results.h5") as file:
            self.nodes, self.cells = file["mesh/nodes"][:], file["mesh/cells"][:]
            return spent, file["frames/force_predicted"][1:], file["fields/displacement"][1:]

    def calculix(self, name, ends, parameters=TRUTH, increments=1):
        """CalculiX on the nodes and elements of the simulation, its ends driven by `ends` (frames, nodes of the mesh, 2)."""
        y, z = self.nodes[:, 1], self.nodes[:, 2]
        sets = {"TOP": cx.where(y > y.max() - 1e-6), "BOTTOM": cx.where(y < y.min() + 1e-6), "MID": cx.where(z < z.min() + 1e-6)}
        parts = [cx.mesh_cards(self.nodes, self.cells), *(cx.set_cards("NSET", *item) for item in sets.items()),
                 cx.material_cards(cx.Law(**parameters), "hencky"), "*BOUNDARY\nMID, 3, 3\n"]
        output = "*NODE PRINT, NSET=ALL, FREQUENCY=1000\nU\n*NODE PRINT, NSET=TOP, TOTALS=ONLY, FREQUENCY=1000\nRF\n"
        for frame in ends:
            driven = "".join(f"{n}, {i}, {i}, {frame[n - 1, i - 1]:.12g}\n" for n in (*sets["TOP"], *sets["BOTTOM"]) for i in (1, 2))
            parts.append(cx.step_cards("*BOUNDARY\n" + driven, output, increments))
        (self.folder / f"{name}.inp").write_text("".join(parts))
        spent = self.seconds(["ccx", "-i", name])
        self.increments = sum(line.strip()[:1].isdigit() for line in open(self.folder / f"{name}.sta"))
        table = cx.read_dat(self.folder / f"{name}.dat")
        return spent, 2.0 * table["total force", "TOP"][:, 0, 1], table["displacements", "ALL"][:, :, 1:]

    def row(self, what, note=""):
        spent = self.times[what]
        self.rows.append({"run": what, "seconds": round(statistics.median(spent), 2), "repeats": len(spent), "accuracy": note})
        print(f"{what:50} {statistics.median(spent):9.2f} s  of {len(spent)}  {note}", flush=True)

    def ratio(self, what, over):
        """Of the medians; the range is that of the pairs, or over the other's median."""
        a, b = self.times[what], self.times[over]
        each = [x / y for x, y in zip(a, b if len(a) == len(b) else [statistics.median(b)] * len(a))]
        value = statistics.median(a) / statistics.median(b)
        self.ratios.append({"ratio": f"{what} / {over}", "value": round(value, 2), "least": round(min(each), 2), "largest": round(max(each), 2), "measured": [len(a), len(b)]})
        print(f"{what} / {over}: {value:.2f} ({min(each):.2f} to {max(each):.2f})", flush=True)

    def alone(self):
        """The direct simulation that is the unit of the identification."""
        what = f"simulation, imic3d, {self.options.increments[0]} a frame"
        for _ in range(self.options.repeats):
            self.times.setdefault(what, []).append(self.simulate("simulation_1", self.options.increments[0])[0])
        self.unknowns = 3 * len(self.nodes)
        self.row(what)

    def against_calculix(self):
        _, fine_force, fine_u = self.simulate("fine", FINE)
        ends = np.zeros((len(VALUES) - 1, len(self.nodes), 2))
        ends[:, :, 1] = np.array(VALUES[1:])[:, None] * np.sign(self.nodes[:, 1]) / 2
        runs = {f"simulation, imic3d, {n} a frame": lambda n=n: self.simulate(f"simulation_{n}", n) for n in self.options.increments}
        runs["simulation, CalculiX"] = lambda: self.calculix("calculix", ends)
        found = {}
        for _ in range(self.options.repeats):
            for what, run in runs.items():
                spent, *found[what] = run()
                self.times.setdefault(what, []).append(spent)
        self.unknowns, cut = 3 * len(self.nodes), self.increments
        for what, (force, u) in found.items():
            reference = fine_force, fine_u
            if what == "simulation, CalculiX" and self.options.fine_calculix:
                reference = self.calculix("calculix_fine", ends, increments=FINE)[1:]
            error = 100 * np.abs(force / reference[0] - 1).max(), 100 * np.abs(u[-1] - reference[1][-1]).max() / np.abs(u[-1]).max()
            note = f", {cut} increments" if what == "simulation, CalculiX" else ""
            self.row(what, "force {:.3f} %, displacement {:.3f} %".format(*error) + note)
        for what in list(runs)[:-1]:
            self.ratio("simulation, CalculiX", what)

    def images(self):
        if (self.folder / "images/truth.json").exists():
            return
        case = (self.text("generate", 2, TRUTH) + f"cameras: [{{name: front, pixel_size: {PIXEL}, place: {{origin: [{(IMAGE[0] - 1) / 2}, {(IMAGE[1] - 1) / 2}]}}}}]\n"
                f"simulate: {{control: displacement, clamped: true, centred: true, steps_per_frame: 8, value: {VALUES}}}\n"
                f"virtual: {{size: {list(IMAGE)}, speckle_size: 5, noise: 0.01, load_noise: 0, static_frames: {STATIC}, seed: 1, directory: images}}\noutput: images\n")
        (self.folder / "virtual.yaml").write_text(case)
        self.imic3d("virtual", "virtual.yaml")

    def identify(self, what, sensitivities, stages, functional="force_driven", more="  steps_per_frame: 1\n  noise_draws: 0\n"):
        name = what.replace(", ", "_").replace(" ", "_")
        start = {key: 0.9 * value for key, value in TRUTH.items()}
        text = self.text("identify", self.options.layers, start) + (
            f"cameras: [{{name: front, pixel_size: {PIXEL}, place: {{origin: [{(IMAGE[0] - 1) / 2}, {(IMAGE[1] - 1) / 2}]}}, images: 'images/images/*.png', frames: 0-{STATIC + FRAMES - 1}, reference: 0-{STATIC - 1}}}]\n"
            "loads: {file: images/loads.csv, image: frame, time: time_s, force: force_N, noise: 1}\n"
            f"identify:\n  functional: {functional}\n  boundary_smoothing: 5\n  sensitivities: {sensitivities}\n  eta: 1e-3\n{more}  stages:\n" +
            "".join(f"    - {{free: [{', '.join(free)}], frames: \"{STATIC}-{STATIC + frames - 1}\"}}\n" for free, frames in stages) + f"output: {name}\n")
        (self.folder / f"{name}.yaml").write_text(text)
        spent = self.imic3d("identify", f"{name}.yaml")
        result = json.loads((self.folder / name / "result.json").read_text())
        return spent, [result["parameters"][key]["value"] for key in TRUTH]

    def identification(self):
        self.images()
        runs = {f"identification, {name}{how}": ("direct", stages, functional) for how, functional in (("", "force_driven"), (", displacement-driven", "displacement_driven"))
                for name, stages in (("four stages", FOUR), ("one stage", ONE))}
        if self.options.perturbed:
            runs["identification, four stages, perturbed"] = ("perturbed", FOUR)
        runs["identification, one stage, displacement-driven, as by default"] = ("direct", ONE, "displacement_driven", "")
        runs["identification, four stages, displacement-driven, as by default"] = ("direct", FOUR, "displacement_driven", "")
        runs["identification, one stage, as by default"] = ("direct", ONE, "force_driven", "")
        runs = {what: how for what, how in runs.items() if self.options.which in what}
        found = {}
        for _ in range(self.options.repeats):
            for what, how in runs.items():
                spent, found[what] = self.identify(what, *how)
                self.times.setdefault(what, []).append(spent)
            case = next(iter(runs)).replace(", ", "_").replace(" ", "_")
            self.times.setdefault("imic3d dic", []).append(self.imic3d("dic", f"{case}.yaml", "--output", "dic"))
        self.row("imic3d dic")
        for what in runs:
            self.row(what, errors(found[what]))
        finest = [what for what in self.times if what.startswith("simulation, imic3d")][-1]
        for what in runs:
            self.ratio(what, next(iter(self.times)))
            if "by default" in what and finest != next(iter(self.times)):
                self.ratio(what, finest)

    def loop(self, what, stages):
        with h5py.File(self.folder / "dic/results.h5") as file:
            surface, dic = file["surface/nodes"][:, :2], file["dic/displacement"][STATIC:, :, :2]
        front = np.flatnonzero(self.nodes[:, 2] > self.nodes[:, 2].max() - 1e-9)
        distance, at = cKDTree(surface).query(self.nodes[front, :2])
        assert distance.max() < 1e-6
        force = np.loadtxt(self.folder / "images/loads.csv", delimiter=",", skiprows=1)[STATIC:, -1]
        ends = np.zeros((FRAMES, len(self.nodes), 2))
        for sign in (-1, 1):
            seen, driven = np.abs(surface[:, 1] - sign * LENGTH / 2) < 1e-6, np.abs(self.nodes[:, 1] - sign * LENGTH / 2) < 1e-6
            shape = lambda x: np.vander(x / 10, 4)
            ends[:, driven] = shape(self.nodes[driven, 0]) @ (np.linalg.pinv(shape(surface[seen, 0])) @ dic[:, seen])
        start = {key: 0.9 * value for key, value in TRUTH.items()}
        values, times = dict(start), []

        @functools.cache
        def residual(frames, *trial):
            spent, predicted, u = self.calculix("loop", ends[:frames], dict(zip(TRUTH, trial)))
            times.append(spent)
            print(f"  {len(times):3} {spent:6.2f} s  {errors(trial)}", flush=True)
            return np.concatenate([((u[:, front, :2] - dic[:frames, at]) / NOISE_DISPLACEMENT).ravel(), (predicted - force[:frames]) / (NOISE_FORCE * force.max())])

        for free, frames in stages:
            trial = lambda x: {**values, **{key: float(x[k] * start[key]) for k, key in enumerate(free)}}
            function = lambda x: residual(frames, *trial(x).values())
            done = least_squares(function, [values[key] / start[key] for key in free], Derivatives(function), xtol=STEP)
            values = trial(done.x)
        self.times.setdefault(what, []).append(sum(times))
        return f"{len(times)} simulations; " + errors(values.values())

    def run(self):
        only = self.options.only.split(",")
        if self.options.cores > 1 and (load := os.getloadavg()[0]) > 0.3:
            print(f"load {load:.1f}: others use this machine, and wall times are worth little")
        self.against_calculix() if "calculix" in only else self.alone()
        if "identification" in only or "loop" in only:
            self.identification()
        if "loop" in only:
            for name, stages in (("one stage", ONE), ("four stages", FOUR)):
                what = f"least_squares and CalculiX, {name}"
                self.row(what, [self.loop(what, stages) for _ in range(self.options.loops)][-1])
                for other in [key for key in self.times if key.startswith("identification")]:
                    self.ratio(what, other)
        processor = re.search(r"model name\s*: (.*)", pathlib.Path("/proc/cpuinfo").read_text())
        head = {"machine": processor[1] if processor else platform.processor(), "cores": os.cpu_count(), "unknowns": self.unknowns, "frames": FRAMES,
                "used": self.options.cores, "seconds": "wall" if self.options.cores > 1 else "processor", "load": os.getloadavg()[0]}
        (self.folder / "benchmark.json").write_text(json.dumps({**head, "rows": self.rows, "ratios": self.ratios, "times": self.times}, indent=1))
        lines = [", ".join(f"{key} {value}" for key, value in head.items()), "", "| run | seconds | median of | accuracy |", "|---|---|---|---|"]
        lines += [f"| {r['run']} | {r['seconds']} | {r['repeats']} | {r['accuracy']} |" for r in self.rows]
        lines += ["", "| ratio | of medians | least to largest | measured |", "|---|---|---|---|"]
        lines += [f"| {r['ratio']} | {r['value']} | {r['least']} to {r['largest']} | {r['measured'][0]} over {r['measured'][1]} |" for r in self.ratios]
        (self.folder / "TABLE.md").write_text("\n".join(lines) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="calculix,identification,loop")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--increments", type=lambda text: [int(n) for n in text.split(",")], default=[1, 3, 4], help="a frame, of imic3d (the first is the unit of the identification)")
    parser.add_argument("--loops", type=int, default=1, help="of scipy and CalculiX, minutes each")
    parser.add_argument("--program", type=pathlib.Path, default=ROOT / "build/release/imic3d")
    parser.add_argument("--output", type=pathlib.Path, default=ROOT / "runs/benchmark")
    parser.add_argument("--size-hole", type=float, default=1.0, help="element size at the hole [mm]")
    parser.add_argument("--size-far", type=float, default=2.5)
    parser.add_argument("--layers", type=int, default=1)
    parser.add_argument("--cores", type=int, default=1, help="wall time on as many, instead of processor time on one")
    parser.add_argument("--which", default="", help="identifications whose name has it: `four stages`, `one stage`, `displacement-driven`")
    parser.add_argument("--no-perturbed", dest="perturbed", action="store_false")
    parser.add_argument("--fine-calculix", action="store_true", help="CalculiX's accuracy against itself with 32 increments a frame")
    options = parser.parse_args()
    options.program = options.program.resolve()
    Benchmark(options).run()


if __name__ == "__main__":
    main()
