#!/usr/bin/python3
"""The paper's virtual test at full size (tools/virtual_study.sh) from 90 and 110 % of the true values: every error below the
paper's, at most 7 iterations.

Usage: virtual_study.py EXECUTABLE [virtual_study_plane_stress]        (default: virtual_study, 3D)
"""
import pathlib
import subprocess
import sys
import tempfile

from runs import SOURCE, end, gmsh, require, run


def main():
    study = sys.argv[2] if len(sys.argv) > 2 else "virtual_study"
    folder = pathlib.Path(tempfile.mkdtemp(prefix="imic3d_study_"))
    for name, sizes in (("generate", dict(length=40, size_hole=0.6, size_far=1.6)), ("identify", dict(length=24, size_hole=1.0, size_far=2.5))):
        gmsh("plate_with_hole", folder / f"{name}.msh", **sizes)
    for name in ("virtual", "case"):
        text = (SOURCE / f"inputs/{study}/{name}.yaml").read_text()
        (folder / f"{name}.yaml").write_text(text.replace(f"../../runs/{study}/", "").replace("mesh: ../virtual_study/", "mesh: "))
    run(sys.argv[1], "virtual", folder / "virtual.yaml", 2)
    done = subprocess.run([SOURCE / "tools/sequential_study.py", folder / "case.yaml", folder / "images/truth.json", "--starts", "0.9,1.1",
                           "--program", sys.argv[1], "--output", folder / "study", "--limit", "1"])
    require(done.returncode == 0, "every mean error is below the paper's")
    end()


main()
