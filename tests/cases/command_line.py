#!/usr/bin/python3
"""What the program says on the command line: output that cannot be written or is not read to its end, options that nobody knows, folders in place of files.

Usage: command_line.py EXECUTABLE
"""
import pathlib
import subprocess
import sys
import tempfile

from runs import end, require

CURVE = """
title: A bar
experiments: [{name: bar, file: bar.csv, strain: strain, stress: stress, noise: 1}]
material: {hardening: linear, parameters: {E: 200e3, nu: 0.3, S_y: 290, H: 900}}
identify: {stages: [{free: [S_y, H]}]}
output: out
"""


def main(program):
    def said(*arguments, stdout=subprocess.PIPE):
        done = subprocess.run([program, *map(str, arguments)], stdout=stdout, stderr=subprocess.PIPE, text=True)
        return done.returncode, done.stderr.strip()

    with tempfile.TemporaryDirectory(prefix="imic3d_command_line_") as made:
        folder = pathlib.Path(made)
        case = folder / "case.yaml"
        case.write_text(CURVE)
        strain = [0.0002 * k for k in range(100)]
        (folder / "bar.csv").write_text("strain,stress\n" + "".join(f"{e:.5f},{min(200e3 * e, 300 + 1000 * (e - 0.0015)) + (-1) ** k:.2f}\n" for k, e in enumerate(strain)))
        for command in (["effects"], ["check", case], ["identify", case], ["--help"]):
            with open("/dev/full", "w") as full:
                status, errors = said(*command, stdout=full)
            require(status == 2 and errors.splitlines()[-1] == "standard output: No space left on device", f"{command[0]} to a full disk: status {status}, {errors[-200:]!r}")
        require((folder / "out/result.json").exists(), "what was identified is there all the same")
        shell = subprocess.run(["bash", "-c", f"{program} effects | head -n 1; echo ${{PIPESTATUS[0]}}"], capture_output=True, text=True)
        require(shell.stdout.splitlines()[-1] == "0" and shell.stderr == "", f"a reader that has seen enough: {shell.stdout.splitlines()[-1]}, {shell.stderr[:200]!r}")
        status, errors = said("check", case, "-unheard_of", "3")
        require(status == 0 and "-unheard_of: nothing has asked for this option" in errors, f"an option that nobody knows: status {status}, {errors!r}")
        for arguments, expected in ((("check", folder), "a case file (YAML)"), (("check", folder / "none.yaml"), "none.yaml: no such file"), (("report", folder), "a results file (.h5)"),
                                    (("identify", case, "--ouput", "x"), "--ouput"), (("identfy", case), "identfy")):
            status, errors = said(*arguments)
            require(status == 2 and expected in errors and "internal" not in errors, f"{arguments[0]} {pathlib.Path(str(arguments[-1])).name}: status {status}, {errors!r}")
    end()


if __name__ == "__main__":
    main(sys.argv[1])
