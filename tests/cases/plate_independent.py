#!/usr/bin/python3
"""The plate that another program computed and drew (IMIC3D_DATA/plate_independent): errors of the identified parameters,
each from 90 % of its true value with the others true (Sec. 4.2).

Usage: plate_independent.py EXECUTABLE
"""
import csv
import subprocess
import sys

from runs import SOURCE, data, end, gmsh, require, workspace

# The paper's, 3D [%]; that of E is 0.07, but E moves by 0.12 with the frames that are used (docs/verification.md).
LIMITS = {"E": 0.2, "S_y": 0.16, "H": 1.9, "delta": 1.3}


def main():
    if data() is None or not (data() / "plate_independent").is_dir():
        print("SKIPPED: no plate_independent in IMIC3D_DATA")
        return
    folder = workspace("plate")
    gmsh("plate_with_hole", folder / "plate.msh", length=24, size_hole=1.0, size_far=2.5)
    case = (SOURCE / "inputs/plate_independent/case.yaml").read_text()
    (folder / "case.yaml").write_text(case.replace("../../runs/data", str(data())))
    subprocess.run([SOURCE / "tools/sequential_study.py", folder / "case.yaml", data() / "plate_independent/truth.json",
                    "--starts", "0.9", "--program", sys.argv[1], "--output", folder / "study"], check=True)
    with open(folder / "study/runs.csv") as file:
        for row in csv.DictReader(file):
            error, name = float(row["error_percent"]), row["parameter"]
            require(abs(error) < LIMITS[name], f"{name}: error {error:+.3f} %, allowed {LIMITS[name]}")
            require(int(row["iterations"]) <= 7, f"{name}: {row['iterations']} iterations")
    end()


main()
