#!/usr/bin/python3
"""The plate that another program computed and drew (IMIC3D_DATA/plate_independent): errors of the identified parameters.

Usage: plate_independent.py EXECUTABLE [--start 0.9] [--refine 0]
One parameter is unknown at a time, the others have their true values, as in the paper's Sec. 4.2.
"""
import argparse
import json
import pathlib
import re
import tempfile

from runs import SOURCE, data, end, gmsh, require, run

STAGES = {"E": "3-7", "S_y": "3-20", "H": "3-47", "delta": "3-47"}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program")
    parser.add_argument("--start", type=float, default=0.9, help="initial guess / true value")
    parser.add_argument("--parameters", default="E,S_y,H,delta")
    parser.add_argument("--functional", default="force_driven")
    parser.add_argument("--size", type=float, default=0.4, help="element size at the hole [mm]")
    parser.add_argument("--layers", type=int, default=5, help="elements through half the thickness")
    arguments = parser.parse_args()
    if data() is None or not (data() / "plate_independent").is_dir():
        print("SKIPPED: no plate_independent in IMIC3D_DATA")
        return
    folder = pathlib.Path(tempfile.mkdtemp(prefix="imic3d_plate_"))
    truth = json.loads((data() / "plate_independent/truth.json").read_text())
    gmsh("plate_with_hole", folder / "plate.msh", length=24, size_hole=arguments.size, size_far=3 * arguments.size)
    shipped = (SOURCE / "inputs/plate_independent/case.yaml").read_text()
    shipped = shipped.replace("../../runs/data", str(data())).replace("layers: 5", f"layers: {arguments.layers}")
    shipped = shipped.replace("force_driven", arguments.functional)
    for name in arguments.parameters.split(","):
        values = {p: truth[p] * (arguments.start if p == name else 1.0) for p in ("E", "S_y", "H", "delta")}
        text = re.sub(r"parameters: \{.*\}", "parameters: {nu: 0.25, %s}" % ", ".join(f"{p}: {v}" for p, v in values.items()), shipped)
        text = re.sub(r"- \{free:.*\}", f"- {{free: [{name}], frames: \"{STAGES[name]}\"}}", text)
        text = re.sub(r"output: .*", f"output: {name}", text)
        (folder / f"{name}.yaml").write_text(text)
        run(arguments.program, "identify", folder / f"{name}.yaml", 2)
        result = json.loads((folder / name / "result.json").read_text())
        error = 100 * (result["parameters"][name]["value"] / truth[name] - 1)
        require(abs(error) < 5.0, f"{name:6} error {error:+.3f} % after {result['iterations_per_stage'][0]} iterations from {arguments.start:.0%}")
    end()


main()
