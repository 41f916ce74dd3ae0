#!/usr/bin/python3
"""Whole runs as ratios of processor time (user and system, one thread): medians, all sides in one call, one after the other.

Usage: benchmark.py [--only calculix,identification,loop] [--repeats 5] [--program FILE] [--output FOLDER] [--size-hole 1 --size-far 2.5 --layers 1]

calculix        one direct simulation of the plate with a hole (hex20) and CalculiX (C3D20R) on the same nodes and elements, with the same
                ends, frames and increments; the law in CalculiX is the transformed table of tools/calculix.py. Accuracy: force and
                displacement of the last frame against the same program with eight times the increments.
identification  E, S_y, H, delta in four stages from 90 % of their values, all of the program (DIC, report), and the part that is left
                without `imic3d dic` of the same frames, over that simulation.
loop            scipy's least_squares (Levenberg-Marquardt, two-point Jacobian) with CalculiX on the DIC's displacement of the surface and
                the force record; ends driven by the true displacement. The number of its simulations is found with imic3d in
                CalculiX's place (the same functions of the same parameters), its time is that number times one CalculiX run.
"""
import argparse
import json
import os
import pathlib
import platform
import re
import resource
import statistics
import subprocess
import sys

import h5py
import numpy as np
from scipy.optimize import least_squares

import calculix as cx

ROOT = pathlib.Path(__file__).resolve().parents[1]
TRUTH = {"E": 198e3, "S_y": 284.0, "H": 1480.0, "delta": 0.042}
VALUES = [0.0, 0.027, 0.045, 0.065, 0.082, 0.099, 0.116, 0.133, 0.15, 0.4, 0.69, 0.98, 1.27, 1.56, 1.85]
STATIC = 3
PIXEL, IMAGE = 0.06, (384, 640)


def seconds(command, folder, threads=1):
    """Processor time of a command; ends the program if it failed."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = dict(os.environ, OMP_NUM_THREADS=str(threads), OPENBLAS_NUM_THREADS=str(threads))
    done = subprocess.run([str(c) for c in command], cwd=folder, capture_output=True, text=True, env=environment)
    if done.returncode != 0 or "*ERROR" in done.stdout:
        sys.exit(f"{' '.join(map(str, command))} ended with {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class Benchmark:
    def __init__(self, options):
        self.options, self.folder = options, options.output.resolve()
        self.folder.mkdir(parents=True, exist_ok=True)
        for name, hole, far, length in (("identify", options.size_hole, options.size_far, 34), ("generate", 0.6, 1.6, 46)):
            sizes = [a for key, value in (("length", length), ("size_hole", hole), ("size_far", far)) for a in ("-setnumber", key, str(value))]
            subprocess.run(["gmsh", "-2", "-v", "1", *sizes, "-format", "msh41", ROOT / "tools/meshes/plate_with_hole.geo", "-o", self.folder / f"{name}.msh"], check=True)
        self.rows = []

    def text(self, mesh, layers, parameters):
        values = ", ".join(f"{name}: {value!r}" for name, value in parameters.items())
        return (f"title: Benchmark\nspecimen: {{mesh: {mesh}.msh, element: hex20, layers: {layers}, layer_ratio: 1.6, mid_plane_symmetry: true, thickness: 8.0, held: bottom, loaded: top, axis: y}}\n"
                f"material: {{law: j2, hardening: power_linear, tie_initial_modulus: true, parameters: {{nu: 0.25, {values}}}}}\n")

    def simulate(self, name, parameters=TRUTH, increments=1):
        path = self.folder / f"{name}.yaml"
        path.write_text(self.text("identify", self.options.layers, parameters) +
                        f"simulate: {{clamped: true, centred: true, steps_per_frame: {increments}, value: {VALUES}}}\noutput: {name}\n")
        spent = seconds([self.options.program, "simulate", path.name], self.folder)
        with h5py.File(self.folder / name / "results.h5") as file:
            return spent, file["frames/force_predicted"][1:], file["fields/displacement"][1:]

    def deck(self, increments=1, law=cx.Law()):
        """CalculiX's input on the nodes and elements of a simulation that was made."""
        with h5py.File(self.folder / "simulation/results.h5") as file:
            nodes, cells = file["mesh/nodes"][:], file["mesh/cells"][:]
        y, z = nodes[:, 1], nodes[:, 2]
        sets = {"TOP": cx.where(y > y.max() - 1e-6), "BOTTOM": cx.where(y < y.min() + 1e-6), "MID": cx.where(z < z.min() + 1e-6)}
        parts = [cx.mesh_cards(nodes, cells), *(cx.set_cards("NSET", *item) for item in sets.items()), cx.material_cards(law, "hencky"),
                 "*BOUNDARY\nTOP, 1, 1\nBOTTOM, 1, 1\nMID, 3, 3\n"]
        output = "*NODE PRINT, NSET=ALL, FREQUENCY=1000\nU\n*NODE PRINT, NSET=TOP, TOTALS=ONLY, FREQUENCY=1000\nRF\n"
        for value in VALUES[1:]:
            parts.append(cx.step_cards(f"*BOUNDARY\nTOP, 2, 2, {value / 2:.12g}\nBOTTOM, 2, 2, {-value / 2:.12g}\n", output, increments))
        return "".join(parts)

    def calculix(self, name, increments=1):
        (self.folder / f"{name}.inp").write_text(self.deck(increments))
        spent = seconds(["ccx", "-i", name], self.folder)
        table = cx.read_dat(self.folder / f"{name}.dat")
        return spent, 2.0 * table["total force", "TOP"][:, 0, 1], table["displacements", "ALL"][:, :, 1:]

    def row(self, what, spent, ratio, note):
        self.rows.append({"run": what, "processor_seconds": round(spent, 2), "ratio": round(ratio, 2), "accuracy": note})
        print(f"{what:44} {spent:9.2f} s  ratio {ratio:7.2f}  {note}", flush=True)

    def against_calculix(self):
        ours, theirs = [], []
        for _ in range(self.options.repeats):
            t, force, u = self.simulate("simulation")
            ours.append(t)
            t, their_force, their_u = self.calculix("calculix")
            theirs.append(t)
        _, fine_force, fine_u = self.simulate("fine", increments=8)
        _, their_fine, their_fine_u = self.calculix("calculix_fine", 8) if self.options.fine_calculix else (0, fine_force, fine_u)
        error = lambda f, u, F, U: f"force {100 * np.abs(f / F - 1).max():.3f} %, displacement {100 * np.abs(u[-1] - U[-1]).max() / np.abs(U[-1]).max():.3f} %"
        reference = "own reference" if self.options.fine_calculix else "reference: imic3d with 8 times the increments"
        one, other = statistics.median(ours), statistics.median(theirs)
        self.unknowns = 3 * u.shape[1]
        self.row("direct simulation, imic3d", one, 1.0, error(force, u, fine_force, fine_u))
        self.row("direct simulation, CalculiX", other, other / one, error(their_force, their_u, their_fine, their_fine_u) + f" ({reference})")
        return one, other

    def images(self):
        if (self.folder / "images/truth.json").exists():
            return
        case = (self.text("generate", 2, TRUTH) + f"cameras: [{{name: front, pixel_size: {PIXEL}, place: {{origin: [{(IMAGE[0] - 1) / 2}, {(IMAGE[1] - 1) / 2}]}}}}]\n"
                f"simulate: {{control: displacement, clamped: true, centred: true, value: {VALUES}}}\n"
                f"virtual: {{size: {list(IMAGE)}, speckle_size: 5, noise: 0.01, load_noise: 0, static_frames: {STATIC}, seed: 1, directory: images}}\noutput: images\n")
        (self.folder / "virtual.yaml").write_text(case)
        seconds([self.options.program, "virtual", "virtual.yaml"], self.folder)

    def identify(self, sensitivities):
        start = {name: 0.9 * value for name, value in TRUTH.items()}
        last = STATIC + len(VALUES) - 2
        text = self.text("identify", self.options.layers, start) + (
            f"cameras: [{{name: front, pixel_size: {PIXEL}, place: {{origin: [{(IMAGE[0] - 1) / 2}, {(IMAGE[1] - 1) / 2}]}}, images: 'images/images/*.png', frames: 0-{last}, reference: 0-{STATIC - 1}}}]\n"
            "loads: {file: images/loads.csv, image: frame, time: time_s, force: force_N, noise: 1}\n"
            f"identify:\n  boundary_smoothing: 5\n  sensitivities: {sensitivities}\n  eta: 1e-3\n  stages:\n"
            f"    - {{free: [E], frames: \"3-4\"}}\n    - {{free: [S_y], frames: \"3-10\"}}\n    - {{free: [H], frames: \"3-{last}\"}}\n    - {{free: [delta], frames: \"3-{last}\"}}\n"
            f"output: identified_{sensitivities}\n")
        (self.folder / f"identify_{sensitivities}.yaml").write_text(text)
        spent = seconds([self.options.program, "identify", f"identify_{sensitivities}.yaml"], self.folder)
        result = json.loads((self.folder / f"identified_{sensitivities}/result.json").read_text())
        return spent, {name: result["parameters"][name]["value"] for name in TRUTH}

    def identification(self, one):
        self.images()
        times, found = {"direct": [], "perturbed": [], "dic": []}, {}
        for _ in range(self.options.repeats):
            for key in ("direct", "perturbed") if self.options.perturbed else ("direct",):
                spent, found[key] = self.identify(key)
                times[key].append(spent)
            times["dic"].append(seconds([self.options.program, "dic", "identify_direct.yaml", "--output", "dic"], self.folder))
        dic = statistics.median(times["dic"])
        self.row("imic3d dic of the same frames", dic, dic / one, "")
        for key in found:
            spent = statistics.median(times[key])
            errors = ", ".join(f"{name} {100 * (found[key][name] / TRUTH[name] - 1):+.2f} %" for name in TRUTH)
            self.row(f"identification, {key}, whole program", spent, spent / one, errors)
            self.row(f"identification, {key}, without the DIC", spent - dic, (spent - dic) / one, "")
        return statistics.median(times["direct"])

    def loop(self, whole, calculix):
        """Number of simulations of the least-squares loop, with imic3d in CalculiX's place."""
        with h5py.File(self.folder / "identified_direct/results.h5") as file:
            surface, dic = file["surface/nodes"][:, :2], file["dic/displacement"][STATIC:, :, :2]
        with h5py.File(self.folder / "simulation/results.h5") as file:
            nodes = file["mesh/nodes"][:]
        front = np.flatnonzero(nodes[:, 2] > nodes[:, 2].max() - 1e-9)
        near = [(i, front[j]) for i, x in enumerate(surface) for j in [np.argmin(np.abs(nodes[front, :2] - x).sum(1))] if np.abs(nodes[front[j], :2] - x).sum() < 1e-6]
        at, of = (np.array(list(p)) for p in zip(*near))
        force = np.loadtxt(self.folder / "images/loads.csv", delimiter=",", comments="#", skiprows=1)[STATIC:, -1]
        count = 0

        def residual(x):
            nonlocal count
            count += 1
            _, predicted, u = self.simulate("simulation", {name: float(x[k] * TRUTH[name]) for k, name in enumerate(TRUTH)})
            return np.concatenate([((u[:, of, :2] - dic[:, at]) / (0.01 * PIXEL)).ravel(), (predicted - force) / 1.0])

        done = least_squares(residual, np.full(4, 0.9), x_scale="jac", diff_step=1e-3, xtol=1e-3)
        errors = ", ".join(f"{name} {100 * (value - 1):+.2f} %" for name, value in zip(TRUTH, done.x))
        self.row(f"least_squares + CalculiX, {count} simulations", count * calculix, count * calculix / whole, errors + " (over the whole identification; time estimated)")

    def run(self):
        only = self.options.only.split(",")
        one, other = self.against_calculix()
        if "identification" in only or "loop" in only:
            whole = self.identification(one)
            if "loop" in only:
                self.loop(whole, other)
        processor = re.search(r"model name\s*: (.*)", pathlib.Path("/proc/cpuinfo").read_text())
        head = {"machine": processor[1] if processor else platform.processor(), "cores": os.cpu_count(), "unknowns": self.unknowns, "frames": len(VALUES) - 1,
                "repeats": self.options.repeats, "threads": 1}
        (self.folder / "benchmark.json").write_text(json.dumps({**head, "rows": self.rows}, indent=1))
        lines = [", ".join(f"{key} {value}" for key, value in head.items()), "", "| run | processor time [s] | ratio | accuracy |", "|---|---|---|---|"]
        lines += [f"| {r['run']} | {r['processor_seconds']} | {r['ratio']} | {r['accuracy']} |" for r in self.rows]
        (self.folder / "TABLE.md").write_text("\n".join(lines) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="calculix,identification,loop")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--program", type=pathlib.Path, default=ROOT / "build/release/imic3d")
    parser.add_argument("--output", type=pathlib.Path, default=ROOT / "runs/benchmark")
    parser.add_argument("--size-hole", type=float, default=1.0, help="element size at the hole [mm]")
    parser.add_argument("--size-far", type=float, default=2.5)
    parser.add_argument("--layers", type=int, default=1)
    parser.add_argument("--no-perturbed", dest="perturbed", action="store_false")
    parser.add_argument("--fine-calculix", action="store_true", help="CalculiX's accuracy against itself with 8 times the increments")
    options = parser.parse_args()
    options.program = options.program.resolve()
    Benchmark(options).run()


if __name__ == "__main__":
    main()
