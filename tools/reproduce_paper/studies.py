#!/usr/bin/python3
"""The studies of the paper's Secs 4.3 and 4.4 on virtual tests; started by tools/reproduce_paper.sh.

Usage: studies.py [--full] [--output FOLDER] [--only alpha,plane_stress,3d,floors] [--jobs 2] [--program FILE] [--setup JSON]

Each run is one `imic3d identify` in a folder of its own, FOLDER/KINEMATICS/NAME, with every parameter true but the free ones.
A run whose case is unchanged and whose result is there is not repeated. Writes runs.csv, iterations.csv and
correlation_error.csv, which page.py reads.
"""
import argparse
import concurrent.futures
import csv
import json
import os
import pathlib
import subprocess
import sys
import time

import h5py
import numpy
from scipy.interpolate import LinearNDInterpolator

ROOT = pathlib.Path(__file__).resolve().parents[2]
TRUTH = {"E": 198e3, "S_y": 284.0, "H": 1480.0, "delta": 0.042}
STARTS = (0.8, 0.9, 1.1, 1.2)
ALPHAS = (0.9, 0.5, 0.1, 1e-2, 1e-3, 1e-4)

# Displacement of the loaded end [mm] in stages 0 (elastic), 1 (plastic strain to 4 %) and 2 (to 30 %), as the paper's.
ELASTIC = [0.009, 0.018, 0.027, 0.036, 0.045]
SHORT = {"plane_stress": [ELASTIC, numpy.linspace(0.058, 0.15, 8), numpy.linspace(0.32, 1.85, 10)],
         "3d": [ELASTIC[2:5:2], numpy.linspace(0.065, 0.15, 6), numpy.linspace(0.4, 1.85, 6)]}
LONG = [ELASTIC, numpy.linspace(0.052, 0.15, 15), numpy.linspace(0.235, 1.85, 20)]
# Of the mesh that generates and the one that identifies: sizes at the hole and far from it, layers, length. At the paper's image size the specimen's
# visible part is shorter, which costs accuracy in 3D (docs/reproduce_paper.md).
QUICK = {"size": [384, 640], "pixel": 0.06, "generate": (0.6, 1.6), "identify": (1.0, 2.5), "layers": (2, 1), "length": (46, 34), "refine": 1, "stages": SHORT}
FULL = {"size": [1024, 1280], "pixel": 0.0225, "generate": (0.6, 1.6), "identify": (1.0, 2.5), "layers": (3, 2), "length": (40, 24), "refine": 1,
        "stages": {"plane_stress": LONG, "3d": LONG}}
# E has images of its own at either size, of stage 0 only: of the paper's size, as the noise goes with the square of the pixel, and
# smoothed more, as cubic splines overrate displacements of less than half a pixel (docs/verification.md).
STAGE_0 = {"pixel": 0.0225, "static": 10, "dic": "dic: {low_pass: 1.5}\n"}
STATIC = 3  # frames before loading of the others

SPECIMEN = {
    "plane_stress": "{{mesh: {mesh}, kinematics: plane_stress, {more}, thickness: 8.0, held: bottom, loaded: top, axis: y}}",
    "3d": "{{mesh: {mesh}, {more}, thickness: 8.0, layer_ratio: 1.6, mid_plane_symmetry: true, held: bottom, loaded: top, axis: y}}"}
CASE = """title: {title}
specimen: {specimen}
cameras: [{{name: front, pixel_size: {pixel}, place: {{origin: [{x}, {y}]}}{images}}}]
material:
  law: j2
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {{E: {E!r}, nu: 0.25, S_y: {S_y!r}, H: {H!r}, delta: {delta!r}}}
"""
VIRTUAL = """simulate: {{control: displacement, clamped: true, centred: true, value: {value}}}
virtual: {{size: {size}, speckle_size: {speckle}, noise: {noise}, load_noise: 0, static_frames: {static}, seed: 1, directory: .}}
output: .
"""
IDENTIFY = """{dic}loads: {{file: {loads}, image: frame, time: time_s, force: force_N, noise: 1}}
identify:
  functional: force_driven
  boundary_smoothing: {smoothing}  # a quarter of the width at most
  sensitivities: {sensitivities}
  steps_per_frame: 1  # as the test is made
  noise_draws: 0
  {options}
  stages: [{{free: {free}, frames: "{frames}"}}]
output: results
"""


class Study:
    def __init__(self, arguments):
        self.full = arguments.full
        self.setup = {**(FULL if arguments.full else QUICK), **json.loads(arguments.setup)}
        self.folder, self.program, self.jobs = arguments.output.resolve(), arguments.program, arguments.jobs
        self.environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", HWLOC_HIDE_ERRORS="2")

    def run(self, command, case):
        """Exit status (0, or 3: not converged) and processor time [s]; what it says goes to COMMAND.log beside the case."""
        log = case.parent / f"{command}.log"
        with open(log, "w") as stream:
            process = subprocess.Popen([self.program, command, case.name], cwd=case.parent, stdout=stream, stderr=subprocess.STDOUT, env=self.environment)
            _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, 3):
            sys.exit(f"{case} ended with {process.returncode}\n{log.read_text()}")
        return process.returncode, usage.ru_utime + usage.ru_stime

    def series(self, kinematics, free):
        """Images that parameters are identified from: name, size, pixel, frames at rest, displacements, last frame, dic section."""
        if free == ("E",):
            rows = 1280 if self.full else 1600  # as many as the mesh is long
            return {**STAGE_0, "size": [1024, rows], "name": "stage_0", "value": ELASTIC, "last": STAGE_0["static"] + len(ELASTIC) - 1}
        stages = self.setup["stages"][kinematics]
        used = stages[:2] if free == ("S_y",) else stages
        return {"name": "images", "size": self.setup["size"], "pixel": self.setup["pixel"], "static": STATIC, "dic": "",
                "value": [v for stage in stages for v in stage], "last": STATIC + sum(len(stage) for stage in used) - 1}

    def text(self, kinematics, series, title, purpose, images="", **parameters):
        setup = self.setup
        elements = {"generate": f"refine: {setup['refine']}, element: quad8", "identify": "element: quad8"} if kinematics == "plane_stress" else \
            {"generate": f"element: hex20, layers: {setup['layers'][0]}", "identify": f"element: hex20, layers: {setup['layers'][1]}"}
        specimen = SPECIMEN[kinematics].format(mesh=self.folder / f"{purpose}.msh", more=elements[purpose])
        values = {**TRUTH, **parameters}
        return CASE.format(title=title, specimen=specimen, pixel=series["pixel"], x=(series["size"][0] - 1) / 2,
                           y=(series["size"][1] - 1) / 2, images=images, **values)

    def meshes(self):
        self.folder.mkdir(parents=True, exist_ok=True)
        for name, length in zip(("generate", "identify"), self.setup["length"]):
            hole, far = self.setup[name]
            sizes = [a for key, value in (("length", length), ("size_hole", hole), ("size_far", far)) for a in ("-setnumber", key, str(value))]
            subprocess.run(["gmsh", "-2", "-v", "2", *sizes, "-format", "msh41", ROOT / "tools/meshes/plate_with_hole.geo", "-o",
                            self.folder / f"{name}.msh"], check=True)

    def images(self, kinematics, free, noise=0.01):
        """Folder of a virtual test, made once."""
        series = self.series(kinematics, free)
        folder = self.folder / kinematics / (series["name"] + ("" if noise else "_without_noise"))
        value = [0.0] + [round(float(v), 4) for v in series["value"]]
        text = self.text(kinematics, series, "The paper's virtual test", "generate") + \
            VIRTUAL.format(value=value, size=series["size"], speckle=5, noise=noise, static=series["static"])
        case = folder / "virtual.yaml"
        if not (folder / "truth.json").exists() or case.read_text() != text:
            folder.mkdir(parents=True, exist_ok=True)
            case.write_text(text)
            status, seconds = self.run("virtual", case)
            if status != 0:
                sys.exit(f"{case}: the simulation did not converge")
            (folder / "seconds").write_text(f"{seconds:.0f}")
            print(f"{kinematics} {folder.name}: {seconds:.0f} s of processor time", flush=True)
        return folder

    def case(self, job):
        """Writes the case of a job; False if its result is there already."""
        kinematics, free = job["kinematics"], job["free"]
        series = self.series(kinematics, free)
        first, last = series["static"], series["last"]
        source = self.images(kinematics, free, job.get("noise", 0.01))
        folder = self.folder / kinematics / job["name"]
        (folder / "images").mkdir(parents=True, exist_ok=True)
        for image in sorted((source / "images").iterdir())[:last + 1]:  # a stage has no use for the others
            link = folder / "images" / image.name
            if not link.exists():
                link.symlink_to(image)
        text = self.text(kinematics, series, job["name"].replace("_", " "), "identify",
                         f", images: 'images/*.png', frames: 0-{last}, reference: 0-{first - 1}",
                         **{name: job["start"] * TRUTH[name] for name in free})
        text += IDENTIFY.format(loads=source / "loads.csv", free=list(free), frames=f"{first}-{last}", dic=series["dic"],
                                smoothing=job.get("smoothing", 5), sensitivities="perturbed" if job.get("alpha") else "direct", options=job.get("options", "eta: 1e-3"))
        case = folder / "case.yaml"
        if case.exists() and case.read_text() == text and (folder / "results/result.json").exists():
            return case, False
        case.write_text(text)
        return case, True

    def identify(self, job):
        case, needed = self.case(job)
        if needed:
            status, seconds = self.run("identify", case)
            if status == 3:
                (case.parent / "results").mkdir(exist_ok=True)
                (case.parent / "results/result.json").write_text(json.dumps({"failed": True}))
            (case.parent / "seconds").write_text(f"{seconds:.0f}")
            print(f"{job['kinematics']} {job['name']}: {seconds:.0f} s of processor time", flush=True)

    def truth_on_the_surface(self, kinematics, name):
        """dic/displacement as `imic3d dic` writes it, of the simulation that the images of a parameter were made from."""
        series = self.series(kinematics, (name,))
        target = self.folder / kinematics / f"true_displacement_{name}.h5"
        dic = self.folder / kinematics / f"{name}_0.9/results/results.h5"
        with h5py.File(self.images(kinematics, (name,)) / "results.h5") as made, h5py.File(dic) as seen:
            nodes, u = made["mesh/nodes"][:], made["fields/displacement"][:]
            front = nodes[:, 2] > nodes[:, 2].max() - 1e-9
            surface, frames = seen["surface/nodes"][:], seen["frames/number"].shape[0]
            values = numpy.zeros((frames, len(surface), 3))
            for t in range(frames):
                step = t - series["static"] + 1  # the images begin with static ones of step 0
                if step > 0:
                    values[t] = LinearNDInterpolator(nodes[front, :2], u[step][front])(surface[:, :2])
        outside = numpy.isnan(values).any(axis=(0, 2))
        if outside.any():  # the hole is a polygon on either mesh: from the nearest node
            for i in numpy.flatnonzero(outside):
                near = numpy.argmin(numpy.linalg.norm(surface[:, :2] - surface[i, :2] + 1e9 * outside[:, None], axis=1))
                values[:, i] = values[:, near]
        with h5py.File(target, "w") as file:
            file["dic/displacement"] = values
            file["dic/displacement"].attrs["unit"] = "mm"
            file["dic/displacement"].attrs["description"] = "true displacement of the surface"
        return target

    def jobs_of(self, only):
        sequential = lambda kinematics: [{"study": "starts", "kinematics": kinematics, "name": f"{name}_{start}", "free": (name,), "start": start}
                                         for name in TRUTH for start in STARTS]
        together = lambda kinematics: [{"study": "pairs", "kinematics": kinematics, "name": f"{'_'.join(pair)}_{start}", "free": pair, "start": start}
                                       for pair in (("S_y", "H"), ("H", "delta")) for start in STARTS]
        if "plane_stress" in only:
            yield sequential("plane_stress")
        if "alpha" in only:
            yield [{"study": "alpha", "kinematics": "plane_stress", "name": f"alpha_{alpha:g}_{name}", "free": (name,), "start": 0.9, "alpha": alpha,
                    "options": f"alpha: {alpha:g}"} for alpha in reversed(ALPHAS) for name in ("E", "S_y")]
        if "floors" in only and "plane_stress" in only:
            yield self.floors("plane_stress", TRUTH)
        if "3d" in only:
            yield sequential("3d")
        if "plane_stress" in only:
            yield together("plane_stress")
        if "floors" in only and "3d" in only:
            yield self.floors("3d", ("E", "H"))
        if "3d" in only:
            yield together("3d")

    def floors(self, kinematics, names):
        """Runs from 90 % with one source of error switched off at a time; `images` and `boundary` say what is left."""
        clean = [{"study": "floors", "kinematics": kinematics, "name": f"clean_{name}", "free": (name,), "start": 0.9, "noise": 0.0}
                 for name in names]
        self.all(clean)
        jobs = clean
        for name in names:
            truth = self.truth_on_the_surface(kinematics, name)
            without_noise = self.folder / kinematics / f"clean_{name}/results/results.h5"
            for case, driving, noise in (("ends_without_noise", without_noise, 0.01), ("ends_true", truth, 0.01), ("clean_ends_true", truth, 0.0)):
                jobs.append({"study": "floors", "kinematics": kinematics, "name": f"{case}_{name}", "free": (name,), "start": 0.9, "noise": noise,
                             "smoothing": 0, "options": f"driving: {driving}"})
        return jobs

    def all(self, jobs):
        for kinematics, free, noise in sorted({(job["kinematics"], "E" if job["free"] == ("E",) else "H", job.get("noise", 0.01)) for job in jobs}):
            self.images(kinematics, (free,), noise)  # before the runs that share them
        with concurrent.futures.ThreadPoolExecutor(self.jobs) as pool:
            list(pool.map(self.identify, jobs))

    def collect(self, jobs):
        """runs.csv, iterations.csv, correlation_error.csv."""
        runs, iterations, errors = [], [], []
        for job in jobs:
            folder = self.folder / job["kinematics"] / job["name"]
            result = json.loads((folder / "results/result.json").read_text())
            head = {"study": job["study"], "kinematics": job["kinematics"], "name": job["name"], "start": job["start"], "alpha": job.get("alpha", 0)}
            if "failed" in result:
                runs.append({**head, "parameter": " ".join(job["free"]), "error_percent": "nan", "noise_percent": "nan", "iterations": "nan",
                             "residual_model": "nan", "residual_dic": "nan", "seconds": (folder / "seconds").read_text()})
                continue
            for name in job["free"]:
                value, sd = (result["parameters"][name][key] for key in ("value", "standard_deviation"))
                runs.append({**head, "parameter": name, "error_percent": f"{100 * (value / TRUTH[name] - 1):.5f}",
                             "noise_percent": f"{100 * (sd or 0) / TRUTH[name]:.5f}", "iterations": result["iterations_per_stage"][0],
                             "residual_model": f"{result['fitted']['residual_rms_model']['value']:.5f}",
                             "residual_dic": f"{result['fitted']['residual_rms_dic']['value']:.5f}",
                             "seconds": (folder / "seconds").read_text()})
            with h5py.File(folder / "results/results.h5") as file:
                group = file["identification/iterations"]
                names = [n.decode() for n in file["identification/parameters"][:]]
                for i in range(int(group["count"][0])):
                    iterations.append({**head, "iteration": int(group["iteration"][i]), "residual": f"{group['residual'][i]:.5f}",
                                       **{n: f"{group['values'][i][names.index(n)] / TRUTH[n]:.6f}" for n in TRUTH}})
                if not (set(job["free"]) == {"H"} and job["start"] == 0.9):
                    continue
                nodes, u = file["surface/nodes"][:], file["dic/displacement"][:]
                top, bottom = nodes[:, 1] > nodes[:, 1].max() - 1e-6, nodes[:, 1] < nodes[:, 1].min() + 1e-6
                for t, number in enumerate(file["frames/number"][:]):
                    model, dic = file["residual/rms_model"][t], file["residual/rms_dic"][t]
                    if numpy.isfinite(model) and number >= STATIC:
                        strain = (u[t, top, 1].mean() - u[t, bottom, 1].mean()) / numpy.ptp(nodes[:, 1])
                        errors.append({**head, "frame": int(number), "mean_strain": f"{strain:.6f}", "model": f"{model:.5f}", "dic": f"{dic:.5f}"})
        for name, rows in (("runs", runs), ("iterations", iterations), ("correlation_error", errors)):
            if not rows:
                continue
            with open(self.folder / f"{name}.csv", "w", newline="") as stream:
                writer = csv.DictWriter(stream, rows[0])
                writer.writeheader()
                writer.writerows(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="the paper's image size")
    parser.add_argument("--output", type=pathlib.Path, required=True)
    parser.add_argument("--only", default="plane_stress,floors,alpha,3d", help="studies to run")
    parser.add_argument("--setup", default="{}", help="what is to differ from the usual meshes and images, e.g. '{\"layers\": [3, 2], \"length\": [40, 24]}'")
    parser.add_argument("--jobs", type=int, default=2, help="runs side by side, a core each")
    parser.add_argument("--program", default=str(ROOT / "build/release/imic3d"))
    arguments = parser.parse_args()
    arguments.program = str(pathlib.Path(arguments.program).resolve())
    begin, study, done = time.time(), Study(arguments), []
    study.meshes()
    for jobs in study.jobs_of(arguments.only.split(",")):
        study.all(jobs)
        done += jobs
        study.collect(done)
    with open(study.folder / "setup.json", "w") as file:
        setup = study.setup
        json.dump({"full": arguments.full, "size": setup["size"], "pixel_mm": setup["pixel"], "frames": {k: sum(len(s) for s in stages) for k, stages in setup["stages"].items()},
                   "lengths_mm": setup["length"], "mesh_generate_mm": setup["generate"], "mesh_identify_mm": setup["identify"], "seconds_of_this_call": round(time.time() - begin)}, file)


main()
