#!/usr/bin/python3
"""Runs that are killed, stopped, starved or broken: afterwards `--resume` ends with the same parameters, and no file is unreadable.

Usage: restart.py EXECUTABLE [--kills 3] [--keep]
The truth is an uninterrupted run on 2 ranks. Moments are drawn with a fixed seed; on which line a run is at that moment is not fixed.
"""
import argparse
import json
import os
import pathlib
import random
import resource
import shutil
import signal
import subprocess
import tempfile
import time
import xml.etree.ElementTree

import h5py
import numpy
from PIL import Image

import fields
import restart_case
from runs import bar, end, require, workspace

CLOSE = 2e-9  # relative, of every parameter; 6e-9 where images are judged in single precision


def descendants(pid):
    """Processes that came from `pid`, itself first."""
    parent = {}
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except (OSError, IndexError):
                pass
    found = [pid]
    for at in found:
        found += [child for child, of in parent.items() if of == at]
    return found


class Run:
    """A command of imic3d under mpirun; `kill` and `finish` end it."""

    def __init__(self, program, case, ranks, resume=False, options=(), before=None, command="identify"):
        line = [program, command, str(case), *(["--resume"] if resume else []), *options]
        if ranks:
            line = ["mpirun", "--oversubscribe", "-n", str(ranks), *line]
        self.line, self.program, self.errors = " ".join(line), program, tempfile.TemporaryFile("w+")
        self.process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=self.errors, preexec_fn=before)

    def ranks(self):
        """The program's own processes."""
        found = []
        for pid in descendants(self.process.pid):
            try:
                if os.path.realpath(f"/proc/{pid}/exe") == os.path.realpath(self.program):
                    found.append(pid)
            except OSError:
                pass
        return found

    def kill(self):
        """kill -9 of everything."""
        for pid in descendants(self.process.pid):
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        self.process.wait()

    def wait_for(self, condition, limit=60.0):
        """Whether `condition` came true while the run went on."""
        until = time.monotonic() + limit
        while time.monotonic() < until and self.process.poll() is None:
            if condition():
                return True
            time.sleep(0.003)
        return False

    def finish(self):
        """Exit status and what was said."""
        status = self.process.wait()
        self.errors.seek(0)
        self.said = self.errors.read()
        return status


def names_in(path):
    """Names of the datasets of an HDF5 file that may be replaced at any moment."""
    names = []
    try:
        with h5py.File(path, "r", locking=False) as file:
            file.visit(names.append)
    except OSError:
        pass
    return names


def unreadable(folder):
    """Files of a folder of results that cannot be read."""
    bad = []
    for path in sorted(folder.iterdir()):
        try:
            if path.suffix == ".h5":
                with h5py.File(path, "r") as file:
                    file.visititems(lambda name, item: item[()] if isinstance(item, h5py.Dataset) else None)
            elif path.suffix == ".json":
                json.loads(path.read_text())
            elif path.suffix == ".xdmf":
                xml.etree.ElementTree.parse(path)
            elif path.suffix == ".png":
                Image.open(path).load()
            elif path.suffix == ".html" and not path.read_text().rstrip().endswith("</html>"):
                bad.append(path.name)
        except Exception as error:  # whatever a reader says
            bad.append(f"{path.name}: {error}")
    return bad


class Trials:
    def __init__(self, program, folder, variant=None):
        self.program, self.folder, self.random = program, folder, random.Random(5)
        stopped, undisturbed = (f"{variant}_{name}" if variant else name for name in ("stopped", "whole"))
        self.case = restart_case.case(folder, stopped, variant=variant)
        self.out = folder / stopped
        whole = restart_case.case(folder, undisturbed, variant=variant)
        begin = time.monotonic()
        status = Run(program, whole, 2).finish()
        self.seconds = time.monotonic() - begin
        require(status == 0, f"the uninterrupted run{' with ' + variant if variant else ''} ends with 0 ({status}), {self.seconds:.1f} s")
        self.truth = restart_case.parameters(folder / undisturbed)
        if not variant:
            shutil.copy(folder / "whole/checkpoint.h5", folder / "whole.h5")

    def start(self, ranks, resume=False, **more):
        if not resume:
            shutil.rmtree(self.out, ignore_errors=True)
        return Run(self.program, self.case, ranks, resume, **more)

    def resumes(self, ranks, what):
        """Goes on and compares."""
        bad = unreadable(self.out) if self.out.is_dir() else []
        run = self.start(ranks, resume=True)
        status = run.finish()
        if status != 0:
            require(False, f"{what}; resumed on {ranks}: status {status}\n{run.said}")
            return run
        apart, deviations = restart_case.difference(self.out, self.truth)
        from_where = next((line.split("checkpoint.h5: ")[1] for line in run.said.splitlines() if "checkpoint.h5: " in line), "?")
        bad += unreadable(self.out)
        require(apart < CLOSE and deviations < 1e-5 and not bad,
                f"{what}; resumed on {ranks} ({from_where}): {apart:.1e}" + (f", deviations {deviations:.1e}" if deviations >= 1e-5 else "") + "".join(f"\n  {one}" for one in bad))
        return run

    def everywhere(self, what):
        """kill -9 as soon as the checkpoint holds something of the correlation, of the first stage, of the second; resumed on other ranks."""
        checkpoint = self.out / "checkpoint.h5"
        for ranks, others, where, reached in ((2, 3, "correlation", lambda names: bool(names)), (3, 1, "first stage", lambda names: "numbers/point" in names),
                                              (1, 2, "second stage", lambda names: "numbers/stages/0/values" in names and "numbers/point" in names)):
            run = self.start(ranks)
            there = run.wait_for(lambda: reached(names_in(checkpoint)), 300.0)
            run.kill()
            require(there, f"{what}: a checkpoint in the {where}")
            self.resumes(others, f"{what}, killed in the {where} on {ranks}")

    def variants(self):
        """Perturbed sensitivities, alpha > 0, three cameras, and images of which a place is left out once it is found."""
        restart_case.make_three_cameras(self.program, self.folder)
        restart_case.make_loose_paint(self.folder)
        for name in restart_case.VARIANTS:
            trials = Trials(self.program, self.folder, name)
            if name == "paint":
                doubts = json.loads((self.folder / "paint_whole/result.json").read_text())["doubts"]
                require(any("speckle no more" in doubt for doubt in doubts), f"the loose paint is found: {doubts}")
            trials.everywhere(name)

    def kills(self, count):
        for trial in range(count):
            ranks = 1 + trial % 3
            run = self.start(ranks)
            times = []
            for again in range(1 + (trial % 3 == 2)):  # each third one is killed twice
                moment = self.random.uniform(0.15, 1.0) * self.seconds * (1.3 if ranks == 3 else 1.0)
                run.wait_for(lambda: False, moment)
                run.kill()
                times.append(f"{moment:.2f} s")
                bad = unreadable(self.out) if self.out.is_dir() else []
                require(not bad, f"no unreadable file after kill -9 at {times[-1]}{''.join(bad)}") if bad else None
                if again < (trial % 3 == 2):
                    run = self.start(1 + (ranks + 1) % 3, resume=True)
            self.resumes(1 + (trial + 1) % 3, f"kill -9 of {ranks} ranks at {' and '.join(times)}")

    def signals(self):
        """SIGUSR1 to mpirun in the first stage, SIGTERM to one rank in the second: status 4, each on other ranks than before."""
        checkpoint = self.out / "checkpoint.h5"
        run = self.start(2)
        run.wait_for(lambda: "numbers/point" in names_in(checkpoint))
        os.kill(run.process.pid, signal.SIGUSR1)
        status = run.finish()
        require(status == 4 and run.said.count("--resume") == 1, f"SIGUSR1 to mpirun: status {status}, one line: " + next((line for line in run.said.splitlines() if "--resume" in line), "none"))
        require(not (self.out / "result.json").exists(), "a stopped run has no result")
        run = self.start(3, resume=True)
        run.wait_for(lambda: "numbers/stages/0/values" in names_in(checkpoint) and "numbers/point" in names_in(checkpoint))
        os.kill(run.ranks()[-1], signal.SIGTERM)
        status = run.finish()
        require(status == 4 and run.said.count("stopped by SIGTERM") == 1, f"SIGTERM to one of 3 ranks: status {status}")
        self.resumes(1, "stopped twice")
        run = self.start(2)
        run.wait_for(checkpoint.exists)
        os.kill(run.process.pid, signal.SIGTERM)
        status = run.finish()
        require("stopped by SIGTERM" in run.said, f"SIGTERM to mpirun reaches the ranks (mpirun itself ends with {status})")
        self.resumes(2, "SIGTERM to mpirun")

    def image(self):
        """The last image disappears while the first stage runs: the second one, on one of the ranks, has to say so."""
        last = sorted((self.folder / "made/images").glob("*.png"))[-1]
        run = self.start(2)
        run.wait_for(lambda: "numbers/point" in names_in(self.out / "checkpoint.h5"))
        last.rename(last.with_suffix(".away"))
        status = run.finish()
        said = [line for line in run.said.splitlines() if line.startswith(str(last))]
        require(status == 2 and len(said) == 1, f"an image disappears: status {status}, {said}")
        run = self.start(2, resume=True)
        status = run.finish()
        require(status == 2 and "7 images" in run.said, f"--resume without it says so: {run.said.splitlines()[:3]}")
        last.with_suffix(".away").rename(last)
        self.resumes(2, "the image is back")

    def dead_rank(self):
        run = self.start(2)
        run.wait_for(lambda: "numbers/point" in names_in(self.out / "checkpoint.h5"))
        time.sleep(self.random.uniform(0.0, 0.1) * self.seconds)
        os.kill(run.ranks()[-1], signal.SIGKILL)
        status = run.finish()
        require(status not in (0, 4), f"a rank dies: mpirun ends with {status}")
        self.resumes(3, "a rank died")

    def disk(self):
        """No file may grow beyond a limit any more."""
        run = self.start(0)
        if not run.wait_for(lambda: "numbers/point" in names_in(self.out / "checkpoint.h5")):
            require(False, "a checkpoint within a stage")
        kept = (self.out / "checkpoint.h5").stat().st_size
        for pid in run.ranks():
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (kept // 2, kept // 2))
            # SIGXFSZ would end the program: a full disk gives an error, the limit a signal; both leave the last checkpoint.
        status = run.finish()
        require(status != 0, f"the limit is reached in mid-run: status {status}")
        self.resumes(1, "there is room again")

    def full_disk(self):
        """A file system of its own that is filled while the run goes on. Needs the right to mount."""
        place = self.folder / "small"
        place.mkdir()
        needed = (self.folder / "whole/results.h5").stat().st_size + 6 * (self.folder / "whole.h5").stat().st_size
        if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={needed + (64 << 20)}", "tmpfs", str(place)], stderr=subprocess.DEVNULL).returncode != 0:
            print("skipped a full disk: a tmpfs cannot be mounted here")
            return
        try:
            run = self.start(2, options=["--output", str(place / "out")])
            run.wait_for(lambda: "numbers/point" in names_in(place / "out/checkpoint.h5"))
            with open(place / "filler", "wb", buffering=0) as filler:
                try:
                    while True:
                        filler.write(b"0" * (1 << 16))
                except OSError:
                    pass
            status = run.finish()
            warned, said = run.said.count("no checkpoint: "), [line for line in run.said.splitlines() if "No space left" in line and "no checkpoint: " not in line]
            require(status == 2 and warned > 0 and len(said) == 1, f"the disk is full in mid-run: status {status}, {warned} warnings, {said}\n{run.said if status != 2 else ''}")
            bad = unreadable(place / "out")
            require(not bad, f"all that is there can be read {bad}")
            (place / "filler").unlink()
            run = self.start(1, resume=True, options=["--output", str(place / "out")])
            status = run.finish()
            apart = restart_case.difference(place / "out", self.truth)[0] if status == 0 else numpy.nan
            require(status == 0 and apart < CLOSE, f"resumed when there is room: {apart:.1e}")
        finally:
            subprocess.run(["umount", str(place)], check=False)

    def broken(self):
        """Checkpoints that are not this run's, cut, or not there."""
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir()
        whole = (self.folder / "whole.h5").read_bytes()

        def refused(contents, *words, case=None):
            (self.out / "checkpoint.h5").write_bytes(contents)
            run = Run(self.program, case or self.case, 2, True)
            status, said = run.finish(), [line for line in run.said.splitlines() if "checkpoint.h5" in line]  # beside what mpirun says
            require(status == 2 and len(said) == 1 and all(word in said[0] for word in words), f"status {status}: {said}")

        refused(whole[:len(whole) // 2], "not a whole checkpoint", "anew")
        refused(b"text", "not a whole checkpoint", "anew")
        refused((self.folder / "whole/results.h5").read_bytes(), "not a checkpoint", "anew")
        other = restart_case.case(self.folder, "other", S_y=270)
        other.write_text(other.read_text().replace("output: other", "output: stopped"))
        refused(whole, "another case: material", "anew", case=other)
        (self.out / "checkpoint.h5").unlink()
        run = self.resumes(1, "no checkpoint")
        require("starts from the beginning" in run.said, "a run without checkpoint says that it starts from the beginning")
        run = self.start(2, resume=True)
        require(run.finish() == 0 and "stage 2 done" in run.said and restart_case.difference(self.out, self.truth)[0] < CLOSE, "--resume of a finished run ends with the same")


def loop(program, folder, kills):
    """imic3d loop on displacement fields in which the magnification drifts: stopped and, with `kills`, killed, each time resumed on other ranks."""
    bar(folder / "strip.msh", -11.0, 11.0, 22, columns=6, half_width=3.5)
    fields.tables(folder / "drift", 1.0, 0.0, False, (0.0, 0.0), 1.5e-3, 2)
    case = folder / "drift.yaml"
    case.write_text(fields.case("drift"))
    checkpoint = folder / "drift/run/loop_checkpoint.h5"

    def answers():
        return len({name.split("/")[2] for name in names_in(checkpoint) if name.startswith("numbers/answers/")})

    def found():
        result = json.loads((folder / "drift/run/result.json").read_text())
        return result["sentence"], result["after"]["parameters"], result["simulations"]

    begin = time.monotonic()
    status = Run(program, case, 2, command="loop").finish()
    truth, all_answers = found(), answers()
    seconds = time.monotonic() - begin
    require(status == 0 and "magnification drift" in truth[0], f"the uninterrupted loop ends with {status}, {seconds:.1f} s, {all_answers} answers: {truth[0]}")

    def resumes(ranks, what):
        bad = unreadable(folder / "drift/run")
        run = Run(program, case, ranks, True, command="loop")
        status = run.finish()
        if status != 0:
            require(False, f"{what}; resumed on {ranks}: status {status}\n{run.said}")
            return
        sentence, values, simulations = found()
        # Whole runs on 1, 2 and 3 ranks are 3e-5 standard deviations apart. More groups of ranks take more simulations, derivatives being shared out: on three ranks that says nothing of what was spared.
        apart = max(abs(values[name]["value"] - one["value"]) / one["standard_deviation"] for name, one in truth[1].items())
        from_where = next((line.split("loop_checkpoint.h5: ")[1] for line in run.said.splitlines() if "loop_checkpoint.h5: " in line), "?")
        require(sentence == truth[0] and apart < 1e-3 and (ranks > 2 or simulations < truth[2]) and not bad, f"{what}; resumed on {ranks} ({from_where}): {apart:.1e} standard deviations, {simulations} of {truth[2]} simulations {bad}")

    for ranks, others in ((2, 3), (3, 1)) if kills else ():
        shutil.rmtree(folder / "drift/run")
        run = Run(program, case, ranks, command="loop")
        there = run.wait_for(lambda: answers() >= 2, 300.0)
        run.kill()
        require(there, "a checkpoint of the loop")
        resumes(others, f"loop killed on {ranks}")
    shutil.rmtree(folder / "drift/run")
    run = Run(program, case, 3, command="loop")
    run.wait_for(checkpoint.exists)
    time.sleep(0.25 * seconds)
    os.kill(run.process.pid, signal.SIGUSR1)
    status = run.finish()
    require(status == 4 and run.said.count("--resume") == 1 and answers() > 5 and not (folder / "drift/run/result.json").exists(), f"SIGUSR1 to a loop: status {status}, {answers()} answers kept")
    resumes(2, "loop stopped")
    case.write_text(case.read_text().replace("modes: 40", "modes: 42"))
    run = Run(program, case, 2, True, command="loop")
    status, said = run.finish(), [line for line in run.said.splitlines() if "loop_checkpoint.h5" in line]
    require(status == 2 and len(said) == 1 and "another case: loop" in said[0], f"another case: status {status}, {said}")


def main():
    options = argparse.ArgumentParser()
    options.add_argument("executable")
    options.add_argument("--kills", type=int, default=3)
    options.add_argument("--keep", action="store_true")
    options.add_argument("--only", help="one of kills, signals, image, dead_rank, disk, full_disk, variants, broken, loop")
    given = options.parse_args()
    folder = workspace("restart")
    if given.only in (None, "loop"):
        loop(given.executable, folder, given.kills > 0)
    if given.only != "loop":
        restart_case.make(given.executable, folder)
        trials = Trials(given.executable, folder)
        for name in [given.only] if given.only else ["broken", "kills", "signals", "image", "dead_rank", "disk", "full_disk", "variants"]:
            trials.kills(given.kills) if name == "kills" else getattr(trials, name)()
    end(given.keep)


main()
