#!/usr/bin/python3
"""The scripts of job_scripts/ on a real SLURM: munged, slurmctld and slurmd of Debian, started here in a folder of their own and ended
with the test. One node with 2 CPUs, no control groups, no accounting. Each script's result must be that of the direct run; the one that
requeues is stopped before its time is up and goes on.

Usage: slurm.py EXECUTABLE        (as root; needs Debian's slurmctld, slurmd, slurm-client and munge)
"""
import os
import pathlib
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

import restart_case
from runs import SOURCE, end, require, workspace

NEEDED = ["munged", "mungekey", "slurmctld", "slurmd", "sbatch", "squeue", "sinfo", "scontrol"]
CONF = """
ClusterName=imic3d
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmdPort={port_d}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
CryptoType=crypto/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SchedulerType=sched/backfill
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
InactiveLimit=0
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def free_ports(count):
    sockets = [socket.socket() for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


class Slurm:
    """The daemons, in the foreground, so that they end with this process's `stop`."""

    def __init__(self, folder):
        self.folder, self.daemons = folder, []
        for name in ("munge", "state", "spool"):
            (folder / name).mkdir(mode=0o755)
        self.host = socket.gethostname().split(".")[0]
        port, port_d = free_ports(2)
        (folder / "slurm.conf").write_text(CONF.format(folder=folder, host=self.host, port=port, port_d=port_d))
        self.environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf")}

    def daemon(self, name, *line):
        log = open(self.folder / f"{name}.out", "w")
        self.daemons.append(subprocess.Popen(line, stdout=log, stderr=subprocess.STDOUT, env=self.environment, start_new_session=True))

    def start(self):
        munge = self.folder / "munge"
        subprocess.run(["mungekey", "--create", f"--keyfile={munge}/key"], check=True)
        self.daemon("munged", "munged", "--foreground", "--force", f"--key-file={munge}/key", f"--socket={munge}/socket", f"--pid-file={munge}/pid",
                    f"--seed-file={munge}/seed", f"--log-file={munge}/log")
        wait(lambda: (munge / "socket").exists(), 20, "munged")
        self.daemon("slurmctld", "slurmctld", "-D", "-c", "-f", str(self.folder / "slurm.conf"))
        wait(lambda: self.ask("scontrol", "ping", check=False).find("is UP") >= 0, 30, "slurmctld")
        self.daemon("slurmd", "slurmd", "-D", "-f", str(self.folder / "slurm.conf"), "-N", self.host)
        wait(lambda: self.ask("sinfo", "-h", "-o", "%t", check=False).strip() == "idle", 60, "slurmd")

    def stop(self):
        for daemon in reversed(self.daemons):
            if daemon.poll() is None:
                daemon.send_signal(signal.SIGTERM)
                try:
                    daemon.wait(20)
                except subprocess.TimeoutExpired:
                    daemon.kill()
                    daemon.wait()

    def ask(self, *line, check=True):
        done = subprocess.run(line, env=self.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        if check and done.returncode != 0:
            raise RuntimeError(f"{' '.join(line)}: {done.stderr}")
        return done.stdout

    def submit(self, *line):
        return self.ask("sbatch", "--parsable", f"--output={self.folder}/job-%A_%a.log", *line).strip().split(";")[0]

    def job(self, number):
        """Key -> value of what scontrol knows of a job (of the first task, if it is an array)."""
        text = self.ask("scontrol", "show", "job", "-o", number, check=False).splitlines()
        return [dict(word.split("=", 1) for word in line.split() if "=" in word) for line in text]

    def done(self, number):
        return all(job["JobState"] in ("COMPLETED", "FAILED", "TIMEOUT", "CANCELLED", "NODE_FAIL") for job in self.job(number))

    def finish(self, number, limit=300):
        wait(lambda: self.done(number), limit, f"job {number}")
        return [(job["JobState"], job["ExitCode"]) for job in self.job(number)]

    def log(self, number):
        return "".join(path.read_text() for path in sorted(self.folder.glob(f"job-{number}_*.log")))


def wait(condition, limit, what):
    until = time.monotonic() + limit
    while not condition():
        if time.monotonic() > until:
            raise RuntimeError(f"{what}: not within {limit} s")
        time.sleep(0.2)


def same(slurm, number, output, truth, what):
    states = slurm.finish(number)
    good = all(state == ("COMPLETED", "0:0") for state in states)
    apart = restart_case.difference(output, truth)[0] if good else float("nan")
    require(good and apart < 1e-8, f"{what}: {states}, {apart:.1e} from the direct run" + ("" if good else "\n" + slurm.log(number)))


def trials(slurm, program, folder):
    scripts = SOURCE / "job_scripts"
    os.environ["IMIC3D"] = slurm.environment["IMIC3D"] = program
    restart_case.make(program, folder)
    subprocess.run(["mpirun", "--oversubscribe", "-n", "2", program, "identify", str(restart_case.case(folder, "direct"))], check=True,
                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    truth = restart_case.parameters(folder / "direct")
    two = ["--ntasks-per-node=2", "--cpus-per-task=1"]

    same(slurm, slurm.submit(*two, str(scripts / "single_node.sh"), str(restart_case.case(folder, "single"))), folder / "single", truth, "single_node.sh, 2 ranks")
    one = ["--nodes=1", "--ntasks-per-node=1", "--cpus-per-task=2"]
    same(slurm, slurm.submit(*one, str(scripts / "many_nodes.sh"), str(restart_case.case(folder, "many"))), folder / "many", truth, "many_nodes.sh, 1 node, 1 rank of 2 threads")

    cases = [restart_case.case(folder, "first"), restart_case.case(folder, "second")]
    (folder / "cases.txt").write_text("".join(f"{case}\n" for case in cases))
    number = slurm.submit("--array=1-2", "--ntasks-per-node=1", str(scripts / "array.sh"), str(folder / "cases.txt"))
    for case in cases:
        same(slurm, number, folder / case.stem, truth, f"array.sh, {case.stem}")

    # A larger case, and a time limit whose signal comes while it runs.
    long = restart_case.case(folder, "long", mesh="long", eta=1e-6)
    begin = time.monotonic()
    subprocess.run(["mpirun", "--oversubscribe", "-n", "2", program, "identify", str(long), "--output", str(folder / "long_direct")], check=True,
                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    seconds = time.monotonic() - begin
    truth = restart_case.parameters(folder / "long_direct")
    number = slurm.submit(*two, "--time=20", str(scripts / "requeue.sh"), str(long))
    wait(lambda: (folder / "long/checkpoint.h5").exists(), 120, "a checkpoint")
    slurm.ask("scancel", "--batch", "--signal=USR1", str(number))  # what --signal would send five minutes before the end
    wait(lambda: slurm.done(number) or slurm.job(number)[0]["Restarts"] != "0", 300, "the requeue")
    while not slurm.done(number):  # a requeued job waits for two minutes, unless it is told to begin; slurmd refuses it in the second in which it was taken off
        time.sleep(3.0)
        if slurm.job(number)[0]["JobState"] == "PENDING":
            slurm.ask("scontrol", "update", f"JobId={number}", "StartTime=now", check=False)
    restarts, said = int(slurm.job(number)[0]["Restarts"]), slurm.log(number)
    same(slurm, number, folder / "long", truth, f"requeue.sh, of {seconds:.0f} s, requeued {restarts} times")
    stops, resumed = said.count("stopped by SIGUSR1"), said.count("goes on from /")
    require(restarts >= 1 and stops == restarts and resumed == restarts, f"{stops} times stopped by the signal, {resumed} times taken up")
    for line in said.splitlines():
        if "stopped by" in line or "goes on from" in line or "requeue" in line or "queue" in line:
            print("    " + line)


def commands(folder):
    """What the scripts would run, without SLURM: a launcher that says its arguments."""
    (folder / "mpirun").write_text('#!/bin/sh\necho "$@"\n')
    (folder / "mpirun").chmod(0o755)
    (folder / "cases.txt").write_text("case.yaml\n")
    environment = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "SLURM_NTASKS": "2", "SLURM_NTASKS_PER_NODE": "2", "SLURM_ARRAY_TASK_ID": "1"}
    for script in ("single_node", "many_nodes", "array", "requeue"):
        case = folder / "cases.txt" if script == "array" else "case.yaml"
        for chosen, command in (({}, "identify"), ({"IMIC3D_COMMAND": "loop"}, "loop")):
            said = subprocess.run(["bash", str(SOURCE / f"job_scripts/{script}.sh"), str(case)], env={**environment, **chosen}, stdout=subprocess.PIPE, text=True).stdout
            require(f" {command} case.yaml" in said, f"{script}.sh runs {command}")


def main():
    with tempfile.TemporaryDirectory() as folder:
        commands(pathlib.Path(folder))
    if require.failed:
        end()
    missing = [name for name in NEEDED if shutil.which(name) is None]
    if missing or os.getuid() != 0:
        print("SKIPPED the SLURM test: " + (f"not installed: {', '.join(missing)} (Debian's slurmctld, slurmd, slurm-client, munge)" if missing else "it needs root"))
        sys.exit(77)
    folder = workspace("slurm")
    folder.chmod(0o755)
    slurm = Slurm(folder)
    try:
        slurm.start()
        print(slurm.ask("sinfo", "--version").strip() + ", " + slurm.ask("sinfo", "-h", "-o", "%n %c CPUs %T").strip(), flush=True)
        trials(slurm, os.path.realpath(sys.argv[1]), folder)
    except RuntimeError as error:
        require(False, str(error))
        for log in folder.glob("*.out"):
            print(f"--- {log.name}\n{log.read_text()[-2000:]}")
        for log in folder.glob("*.log"):
            print(f"--- {log.name}\n{log.read_text()[-2000:]}")
    finally:
        slurm.stop()
        left = [daemon.args[0] for daemon in slurm.daemons if daemon.poll() is None]
        require(not left, f"all daemons have ended {left}")
    end()


main()
