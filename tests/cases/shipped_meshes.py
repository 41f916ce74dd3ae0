#!/usr/bin/python3
"""Every mesh that a shipped case file names is made by tools/make_meshes.sh, or by the run that the case belongs to."""
import pathlib
import re
import sys

root = pathlib.Path(__file__).resolve().parents[2]
made = set(re.findall(r"inputs/\S+\.msh", (root / "tools/make_meshes.sh").read_text()))
lacking, named = [], 0
for case in sorted(root.glob("inputs/*/*.yaml")):
    for mesh in re.findall(r"^[^#\n]*\b(?:mesh|declared_mesh): *([^\s,}]+\.msh)", case.read_text(), re.MULTILINE):
        file = (case.parent / mesh).resolve().relative_to(root)
        named += 1
        if file.parts[0] != "runs" and str(file) not in made:
            lacking.append(f"{case.relative_to(root)}: {file}")
print(f"{named} meshes named, {len(made)} made")
if lacking or named < 10:
    sys.exit("not made by tools/make_meshes.sh: " + ", ".join(lacking))
