#!/usr/bin/python3
"""How time and memory grow with the size of a problem: powers by least squares of the logarithms. Processor time of one thread.

Usage: scaling.py {unknowns,frames,parameters,ranks,cluster,loop} [--sizes 1e4,1e5] [--program FILE] [--output FOLDER]

unknowns    `imic3d simulate` of the plate with a hole (hex20, four frames into the plastic range): MUMPS, and GMRES with two grids (others: --solvers). --largest-direct: no MUMPS in memory beyond it
frames      `imic3d dic` and `imic3d identify` (one stage, direct sensitivities) on so many images of one test
parameters  `imic3d identify`, one iteration, with so many free parameters of a law with kinematic hardening, anisotropy, rate and a Voce term
loop        processor and wall time of `imic3d loop` in units of `imic3d identify`, on a test in which nothing is missing and on one whose force is 2 kN too large; one rank and two
ranks       wall time of `imic3d simulate` on one rank and on two, in turns, with PETSc's own times of assembly and solution; wants a machine that does nothing else
cluster     a model of `imic3d simulate` on many ranks: work of one rank, its largest share as MUMPS counts it, messages and bytes as Open MPI counts them; for two networks
Megapixels: tests/benchmarks, benchmark_frame (docs/performance.md). Writes TABLE_<what>.md into the folder and prints it."""
import argparse
import json
import os
import pathlib
import re
import subprocess
import sys
import time

import h5py
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[1]
SIMULATED = [0.0, 0.027, 0.1, 0.15, 0.3]  # elongation [mm]: two frames in the elastic range, two beyond it
SOLVERS = {"MUMPS": ["-mechanics_ksp_type", "preonly", "-mechanics_pc_type", "cholesky", "-mechanics_pc_factor_mat_solver_type", "mumps"],
           "MUMPS, factors on disk": ["-mechanics_ksp_type", "preonly", "-mechanics_pc_type", "cholesky", "-mechanics_pc_factor_mat_solver_type", "mumps", "-mat_mumps_icntl_22", "1"],
           "two grids": ["-mechanics_pc_type", "mg"],
           "GAMG": ["-mechanics_ksp_type", "gmres", "-mechanics_pc_type", "gamg", "-mechanics_ksp_rtol", "1e-8"]}
NETWORKS = {"InfiniBand": (2e-6, 1e10), "Ethernet": (3e-5, 1.1e9)}  # time of a message [s], rate [bytes/s]
STATIC, PIXEL, IMAGE, LENGTH = 2, 0.06, (384, 640), 34
START = {"E": 195e3, "S_y": 280.0, "H": 1450.0, "delta": 0.041}
# Free ones in this order, 16 in all; the first four are START's.
MORE = {"nu": 0.26, "C_1": 300.0, "R_12": 1.0, "C_rate": 1e-4, "Q_v": 2.0, "R_22": 1.0, "R_33": 1.0, "gamma_1": 100.0, "b_v": 20.0, "heating": 1e-6, "friction": 1e-3, "dilatancy": 1e-3}


def power(sizes, values):
    """The exponent of values ~ sizes^exponent."""
    return np.polyfit(np.log(sizes), np.log(values), 1)[0] if len(sizes) > 1 else float("nan")


class Scaling:
    def __init__(self, options):
        self.options, self.folder = options, options.output.resolve()
        self.folder.mkdir(parents=True, exist_ok=True)

    def mesh(self, name, **sizes):
        numbers = [text for key, value in sizes.items() for text in ("-setnumber", key, str(value))]
        subprocess.run(["gmsh", "-2", "-v", "1", *numbers, "-format", "msh41", ROOT / "tools/meshes/plate_with_hole.geo", "-o", self.folder / f"{name}.msh"], check=True)

    def run(self, *arguments, ranks=1, mpi=(), allowed=(0,)):
        """Processor time, wall time and largest resident memory [kB] of a command, and what it printed. `allowed`: exit statuses."""
        command = [*(["mpirun", "-n", str(ranks), "--oversubscribe", *mpi] if ranks > 1 or mpi else []), self.options.program, *arguments]
        begin = time.perf_counter()
        process = subprocess.Popen(list(map(str, command)), cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1"))
        said = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        if os.waitstatus_to_exitcode(status) not in allowed:
            sys.exit(f"{' '.join(map(str, command))} ended with {os.waitstatus_to_exitcode(status)}\n{said[-2000:]}")
        return used.ru_utime + used.ru_stime, time.perf_counter() - begin, used.ru_maxrss, said

    def text(self, mesh, layers, parameters, effects=""):
        values = ", ".join(f"{name}: {value!r}" for name, value in {"nu": 0.25, **parameters}.items())
        return (f"title: Scaling\nspecimen: {{mesh: {mesh}.msh, element: hex20, layers: {layers}, layer_ratio: 1.6, mid_plane_symmetry: true, thickness: 8.0, held: bottom, loaded: top, axis: y}}\n"
                f"material: {{law: j2, hardening: power_linear, tie_initial_modulus: true{effects}, parameters: {{{values}}}}}\n")

    def plate(self, wanted, values=SIMULATED):
        """A simulation of about as many unknowns; these are counted in its results."""
        edge = (3474 / wanted) ** (1 / 3)
        name, layers = f"plate_{wanted:.0f}", max(1, round(1.3 / edge - 0.3))
        self.mesh(name, length=LENGTH, size_hole=1.0 * edge, size_far=2.5 * edge)
        (self.folder / f"{name}.yaml").write_text(self.text(name, layers, START) + f"simulate: {{clamped: true, centred: true, value: {values}}}\noutput: {name}\n")
        return name

    def unknowns(self):
        rows, known = ["| unknowns | solver | processor time [s] | memory [GB] | kB per unknown | force of the last frame |", "|---|---|---|---|---|---|"], {}
        for wanted in self.options.sizes or [1e4, 3e4, 1e5, 3e5, 1e6]:
            name = self.plate(wanted)
            for solver in self.options.solvers:
                how = SOLVERS[solver]
                if solver == "MUMPS" and wanted > self.options.largest_direct:
                    continue
                spent, _, memory, _ = self.run("simulate", f"{name}.yaml", *how)
                with h5py.File(self.folder / name / "results.h5") as file:
                    count, force = 3 * len(file["mesh/nodes"]), file["frames/force_predicted"][-1]
                known.setdefault(solver, []).append((count, spent, memory))
                rows.append(f"| {count} | {solver} | {spent:.1f} | {memory / 2**20:.2f} | {memory / count:.1f} | {force:.6g} |")
                print(rows[-1], flush=True)
        for solver, of in known.items():
            counts, spent, memory = np.array(of).T
            rows.append(f"\n{solver}: time with the power {power(counts, spent):.2f} of the unknowns, memory {power(counts, memory):.2f}.")
        return rows

    def images(self, frames):
        """A test of as many frames, seen by one camera."""
        name = f"test_{frames}"
        if not (self.folder / name / "truth.json").exists():
            self.mesh("generate", length=46, size_hole=0.6, size_far=1.6)
            self.mesh("identify", length=LENGTH, size_hole=1.0, size_far=2.5)
            values = [0.0, *np.round(np.linspace(0.01, 1.85, frames), 5).tolist()]
            truth = {"E": 198e3, "S_y": 284.0, "H": 1480.0, "delta": 0.042}
            (self.folder / f"{name}_virtual.yaml").write_text(
                self.text("generate", 1, truth) + f"cameras: [{{name: front, pixel_size: {PIXEL}, place: {{origin: [{(IMAGE[0] - 1) / 2}, {(IMAGE[1] - 1) / 2}]}}}}]\n"
                f"simulate: {{control: displacement, clamped: true, centred: true, value: {values}}}\n"
                f"virtual: {{size: {list(IMAGE)}, speckle_size: 5, noise: 0.01, load_noise: 1, static_frames: {STATIC}, directory: {name}}}\noutput: {name}\n")
            self.run("virtual", f"{name}_virtual.yaml")
        return name

    def identification(self, frames, free, values, effects="", more=""):
        name = self.images(frames)
        case = f"{name}_{len(free)}"
        (self.folder / f"{case}.yaml").write_text(
            self.text("identify", 1, values, effects) +
            f"cameras: [{{name: front, pixel_size: {PIXEL}, place: {{origin: [{(IMAGE[0] - 1) / 2}, {(IMAGE[1] - 1) / 2}]}}, images: '{name}/images/*.png', frames: 0-{STATIC + frames - 1}, reference: 0-{STATIC - 1}}}]\n"
            f"loads: {{file: {name}/loads.csv, image: frame, time: time_s, force: force_N, noise: 1}}\n"
            f"identify:\n  boundary_smoothing: 5\n  sensitivities: direct\n  steps_per_frame: 1\n  noise_draws: 0\n{more}  stages:\n    - {{free: [{', '.join(free)}], frames: \"{STATIC}-{STATIC + frames - 1}\"}}\noutput: {case}\n")
        return case

    def frames(self):
        rows, known = ["| frames | dic [s] | memory [GB] | identify [s] | memory [GB] | iterations |", "|---|---|---|---|---|---|"], []
        for frames in map(int, self.options.sizes or [5, 20, 50, 200]):
            case = self.identification(frames, [*START], START)
            dic, _, of_dic, _ = self.run("dic", f"{case}.yaml", "--output", f"{case}_dic")
            spent, _, memory, _ = self.run("identify", f"{case}.yaml")
            stages = json.loads((self.folder / case / "result.json").read_text())["stages"]
            iterations = sum(stage["iterations"] for stage in stages)
            known.append((frames, dic, spent, memory))
            rows.append(f"| {frames} | {dic:.1f} | {of_dic / 2**20:.2f} | {spent:.1f} | {memory / 2**20:.2f} | {iterations} |")
            print(rows[-1], flush=True)
        counts, dic, spent, memory = np.array(known, float).T
        return [*rows, f"\nWith the frames: dic with the power {power(counts, dic):.2f}, identify {power(counts, spent):.2f}, its memory {power(counts, memory):.2f}."]

    def parameters(self):
        values = {**START, **MORE}
        rows, known = ["| parameters | identify, one iteration [s] | memory [GB] |", "|---|---|---|"], []
        for count in map(int, self.options.sizes or [1, 2, 4, 8, 16]):
            case = self.identification(20, [*values][:count], values, ", effects: [kinematic, hill, rate, voce_term, heating, pressure]", "  max_iterations: 1\n")
            spent, _, memory, _ = self.run("identify", f"{case}.yaml", allowed=(0, 3))  # one iteration does not converge
            known.append((count, spent, memory))
            rows.append(f"| {count} | {spent:.1f} | {memory / 2**20:.2f} |")
            print(rows[-1], flush=True)
        counts, spent, _ = np.array(known, float).T
        each, first = np.polyfit(counts, spent, 1)
        return [*rows, f"\nTime: {first:.1f} s + {each:.2f} s for each parameter; with the power {power(counts, spent):.2f} of their number."]

    def ranks(self):
        events = {"assembly": "imic3dTangent|imic3dForces", "factorisation": "MatCholFctrNum", "substitution": "MatSolve"}
        rows = ["| unknowns | ranks | wall time [s] | " + " | ".join(f"{event} [s]" for event in events) + " |", "|---|---|---|" + "---|" * len(events)]
        for wanted in self.options.sizes or [1e4, 5e4]:
            name, best = self.plate(wanted), {}
            for _ in range(3):
                for ranks in (1, 2):
                    _, wall, _, said = self.run("simulate", f"{name}.yaml", *SOLVERS["MUMPS"], "-log_view", ranks=ranks)
                    times = [sum(float(m[1]) for m in re.finditer(rf"^(?:{pattern})\s+\d+\s+\S+\s+(\S+)", said, re.M)) for pattern in events.values()]
                    best[ranks] = np.minimum(best.get(ranks, np.inf), [wall, *times])
            with h5py.File(self.folder / name / "results.h5") as file:
                count = 3 * len(file["mesh/nodes"])
            rows += [f"| {count} | {ranks} | " + " | ".join(f"{value:.2f}" for value in best[ranks]) + " |" for ranks in best]
            rows.append(f"| {count} | one over two | " + " | ".join(f"{value:.2f}" for value in best[1] / np.maximum(best[2], 1e-9)) + " |")
            print("\n".join(rows[-3:]), flush=True)
        return rows

    def iteration(self, wanted, ranks):
        """What one of Newton's iterations takes, as the difference of a long and a short run: times [s] of elements and of factor and substitution, unknowns, operations of factorisations
        of each rank, and the largest number of messages and bytes that a rank sends."""
        known = []
        for values in (SIMULATED[:2], SIMULATED):
            name, traffic = self.plate(wanted, values), self.folder / "traffic"
            for old in traffic.parent.glob("traffic.*.prof"):
                old.unlink()
            said = self.run("simulate", f"{name}.yaml", *SOLVERS["MUMPS"], "-log_view", "-mechanics_ksp_view", "::ascii_info_detail", ranks=ranks, mpi=[
                "--mca", "mpi_yield_when_idle", str(int(ranks > 1)), "--mca", "pml_monitoring_enable", "2", "--mca", "pml_monitoring_enable_output", "3", "--mca", "pml_monitoring_filename", traffic])[3]
            event = {m[1]: (int(m[2]), float(m[3])) for m in re.finditer(r"^(imic3dTangent|imic3dForces|MatCholFctrNum|MatSolve)\s+(\d+)\s+\S+\s+(\S+)", said, re.M)}
            operations = re.search(r"RINFO\(3\).*\n((?:\s+\[\d+\] \S+\n)+)", said)[1]
            sent = []
            for rank in range(ranks):
                lines = [line.split("\t") for line in (self.folder / f"traffic.{rank}.prof").read_text().splitlines() if line[:2] in ("E\t", "I\t")]
                sent.append([sum(int(line[4].split()[0]) for line in lines if int(line[2]) != rank), sum(int(line[3].split()[0]) for line in lines if int(line[2]) != rank)])
            with h5py.File(self.folder / name / "results.h5") as file:
                count = 3 * len(file["mesh/nodes"])
            known.append((event["MatCholFctrNum"][0], event["imic3dTangent"][1] + event["imic3dForces"][1], event["MatCholFctrNum"][1] + event["MatSolve"][1], np.array(sent, float)))
        (few, elements, solver, sent), (many, more_elements, more_solver, more_sent) = known
        per = 1 / (many - few)
        return (more_elements - elements) * per, (more_solver - solver) * per, count, np.array([float(line.split()[1]) for line in operations.splitlines()]), ((more_sent - sent) * per).max(axis=0)

    def cluster(self):
        rows = ["| unknowns | ranks | largest share of the factorisation | messages of a rank | MB of a rank | " + " | ".join(f"{network}: iteration [ms] | speed-up" for network in NETWORKS) + " |", "|---|---|---|---|---|" + "---|---|" * len(NETWORKS)]
        for wanted in self.options.sizes or [1e4, 5e4]:
            for ranks in (1, 2, 4, 8, 16, 32):
                elements, solver, count, operations, (messages, sent) = self.iteration(wanted, ranks)
                if ranks == 1:
                    alone, of_elements, of_solver = operations.sum(), elements, solver
                share = operations.max() / alone
                times = [of_elements / ranks + of_solver * share + messages * latency + sent / rate for latency, rate in NETWORKS.values()]
                rows.append(f"| {count} | {ranks} | {share:.3f} | {messages:.0f} | {sent / 1e6:.2f} | " + " | ".join(f"{1e3 * one:.1f} | {(of_elements + of_solver) / one:.1f}" for one in times) + " |")
                print(rows[-1], flush=True)
        return rows

    def loop(self):
        import false_alarms
        rows = ["| test | command | ranks | verdict | simulations | processor time [s] | wall time [s] | of one identification, processor time | wall time |", "|---|---|---|---|---|---|---|---|---|"]
        for test, offset in {"nothing missing": 0.0, "force 200 N too large": 200.0}.items():
            folder = self.folder / test.replace(" ", "_")
            folder.mkdir(exist_ok=True)
            false_alarms.images(self.options.program)(folder, {}, 1)
            loads = np.loadtxt(folder / "test/loads.csv", delimiter=",", skiprows=1)
            loads[:, 2] += offset
            np.savetxt(folder / "test/loads.csv", loads, fmt="%.8g", delimiter=",", header="frame,time_s,force_N", comments="")
            case = folder / "case.yaml"
            case.write_text("".join(line for line in case.read_text().splitlines(True) if not line.startswith("loop:")))
            for ranks in (1, 2):
                unit = None
                for command in ("identify", "loop"):
                    spent, wall, _, _ = self.run(command, case, "--output", folder / f"{command}_{ranks}", ranks=ranks)
                    unit = unit or (spent, wall)
                    result = json.loads((folder / f"{command}_{ranks}/result.json").read_text())
                    verdict = f"{result['verdict']} {', '.join(result['named'])}" if command == "loop" else "–"
                    rows.append(f"| {test} | {command} | {ranks} | {verdict} | {result.get('simulations', '–')} | {spent:.1f} | {wall:.1f} | {spent / unit[0]:.1f} | {wall / unit[1]:.1f} |")
                    print(rows[-1], flush=True)
        return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["unknowns", "frames", "parameters", "ranks", "cluster", "loop"])
    parser.add_argument("--sizes", type=lambda text: [float(one) for one in text.split(",")])
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=["MUMPS", "two grids"])
    parser.add_argument("--largest-direct", type=float, default=3e5, help="unknowns")
    parser.add_argument("--program", type=pathlib.Path, default=ROOT / "build/release/imic3d")
    parser.add_argument("--output", type=pathlib.Path, default=ROOT / "runs/scaling")
    options = parser.parse_args()
    options.program = options.program.resolve()
    rows = getattr(Scaling(options), options.what)()
    (options.output / f"TABLE_{options.what}.md").write_text("\n".join(rows) + "\n")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
