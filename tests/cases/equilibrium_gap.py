#!/usr/bin/python3
"""Poisson's ratio without any force (Eq. 2): images of an elastic plate with a hole, made on a finer mesh of other elements, noisy
and quantised; the load record says 0 throughout. From 0.15 and 0.45; with 1 and 2 ranks; E declared free is refused.

Usage: equilibrium_gap.py EXECUTABLE
"""
import json
import re
import sys

from runs import end, gmsh, require, run, workspace

NU = 0.3
CASE = """
title: Elastic plate with a hole
specimen: {{mesh: {mesh}.msh, kinematics: plane_stress, element: {element}, thickness: 4, held: bottom, loaded: top{more}}}
cameras: [{{name: front, pixel_size: 0.045, place: {{origin: [239.5, 269.5]}}{images}}}]
material: {{law: elastic, parameters: {{E: 70e3, nu: {nu}}}}}
"""


def main():
    program, folder = sys.argv[1], workspace("gap")
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.4, size_far=1.2)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    (folder / "virtual.yaml").write_text(CASE.format(mesh="fine", element="quad4", more=", refine: 1", images="", nu=NU) + """
simulate: {centred: true, value: [0, 0.1, 0.2, 0.3, 0.4]}
virtual: {size: [480, 540], noise: 0.01, static_frames: 3, directory: made}
output: made
""")
    run(program, "virtual", folder / "virtual.yaml")
    loads = folder / "made/loads.csv"
    loads.write_text(re.sub(r",[^,\n]*$", ",0", loads.read_text(), flags=re.M).replace("time_s,0", "time_s,force_N"))
    identify = lambda nu, free, output: CASE.format(mesh="coarse", element="quad8", more="", images=", images: 'made/images/*.png', reference: 0-2", nu=nu) + f"""
loads: {{file: made/loads.csv, noise: 1}}
identify: {{functional: equilibrium_gap, alpha: 1e-3, stages: [{{free: {free}, frames: 3-6}}]}}
output: {output}
"""
    found = {}
    for start in (0.15, 0.45):
        case = folder / f"from_{start}.yaml"
        case.write_text(identify(start, "[nu]", f"from_{start}"))
        run(program, "identify", case)
        result = json.loads((folder / f"from_{start}/result.json").read_text())
        found[start], sd = result["parameters"]["nu"]["value"], result["parameters"]["nu"]["standard_deviation"]
        require(abs(found[start] / NU - 1) < 0.02, f"from {start}: nu {found[start]:.5f} +- {sd:.5f}, {result['iterations_per_stage'][0]} iterations")
    require(abs(found[0.15] - found[0.45]) < 2e-3 * NU, "the start leaves no trace")
    require(abs(found[0.15] - NU) < 4 * sd + 0.005 * NU, "within the noise and 0.5 % of the meshes")
    run(program, "identify", folder / "from_0.45.yaml", 2, ["--output", str(folder / "two")])
    two = json.loads((folder / "two/result.json").read_text())["parameters"]["nu"]["value"]
    require(abs(two / found[0.45] - 1) < 1e-8, f"2 ranks find the same ({two / found[0.45] - 1:.1e})")
    (folder / "free.yaml").write_text(identify(0.3, "[E, nu]", "free"))
    message = run(program, "identify", folder / "free.yaml", 1, status=2, errors=True)
    require("E with functional: equilibrium_gap" in message and "ratios" in message, "E declared free is refused: " +
            next(line for line in message.splitlines() if "equilibrium_gap;" in line))
    end()


main()
