#!/usr/bin/python3
"""`imic3d loop` on a plate with a hole of which a part, between the places where the loop begins to look and smaller than it expects, is weaker than the rest: it is named, with its place.
Images of imic3d virtual: longer plate, finer mesh, more increments, noise, 8 bits.

Usage: loop_region.py EXECUTABLE
"""
import json
import pathlib
import sys
import tempfile

from runs import end, gmsh, require, run

LAW = "{{law: j2, hardening: power_linear, tie_initial_modulus: true, parameters: {{E: {}, nu: 0.25, S_y: {}, H: {}, delta: 0.042}}}}"
TRUE, DECLARED = LAW.format(198e3, 284, 1480), LAW.format(190e3, 278, 1420)
REGION = {"region": -0.08, "region_x": 0.68, "region_y": 0.30, "region_radius": 0.13}
VIRTUAL = f"""
title: Plate with a soft spot
specimen: {{mesh: long.msh, kinematics: plane_stress, refine: 2, element: quad8, thickness: 8.0, held: bottom, loaded: top}}
cameras: [{{name: front, pixel_size: 0.09, place: {{origin: [124.5, 159.5]}}}}]
material: {TRUE}
simulate: {{control: displacement, clamped: true, centred: true, steps_per_frame: 16, value: [0, 0.012, 0.03, 0.048, 0.06, 0.09, 0.12, 0.15, 0.22, 0.3, 0.44, 0.6, 0.8, 1.0, 1.2, 1.4]}}
virtual: {{size: [250, 320], speckle_size: 5, noise: 0.01, load_noise: 20, static_frames: 5, seed: 1, directory: test, declared_mesh: plate.msh}}
effects: {{stiff_or_soft_region: {json.dumps(REGION)}}}
output: test
"""
LOOP = f"""
title: Plate, the rest unknown
specimen: {{mesh: plate.msh, kinematics: plane_stress, element: quad8, thickness: 8.0, held: bottom, loaded: top}}
cameras: [{{name: front, pixel_size: 0.09, place: {{origin: [124.5, 159.5]}}, images: "test/images/*.png", reference: 0-4}}]
loads: {{file: test/loads.csv, image: frame, time: time_s, force: force_N, noise: 20}}
material: {DECLARED}
identify: {{functional: displacement_driven, stages: [{{free: [E, S_y, H, delta]}}]}}
loop: {{draws: 60, rivals: 2, additions: 2, starts: [1.0]}}
output: run
"""


def main():
    program = sys.argv[1]
    folder = pathlib.Path(tempfile.mkdtemp(prefix="imic3d_loop_region_"))
    gmsh("plate_with_hole", folder / "long.msh", length=40, size_hole=1.6, size_far=2.5)
    gmsh("plate_with_hole", folder / "plate.msh", length=24, size_hole=1.6, size_far=4.0)
    (folder / "virtual.yaml").write_text(VIRTUAL)
    (folder / "loop.yaml").write_text(LOOP)
    run(program, "virtual", folder / "virtual.yaml", 2)
    run(program, "loop", folder / "loop.yaml", 2)
    result = json.loads((folder / "run/result.json").read_text())
    found, chi = result["after"]["parameters"], result["after"]["chi"]
    print(result["sentence"])
    require(result["verdict"] == "attributed" and result["named"] == ["stiff or soft region"], f"{result['verdict']}: {result['named']}, set {result['set']}")
    require(chi["held_out"] < 1.05 * chi["null_held_out"], f"held out {chi['held_out']:.2f} (null {chi['null_held_out']:.2f})")
    # Elements of 4 mm, in which the strength is one number each, tell the middle of a spot of 2.6 mm to half a millimetre of the 20 x 24 mm, and little of depth and radius but their product.
    for name, allowed in (("region_x", 0.06), ("region_y", 0.03)):
        require(abs(found[name]["value"] - REGION[name]) < allowed, f"{name} {found[name]['value']:.3f} +- {found[name]['standard_deviation']:.3f} ({REGION[name]})")
    strength = lambda p: p["region"] * p["region_radius"] ** 2
    require(abs(strength({name: found[name]["value"] for name in REGION}) / strength(REGION) - 1) < 0.25, f"region times radius squared {strength({name: found[name]['value'] for name in REGION}):.5f} ({strength(REGION):.5f})")
    require(abs(found["E"]["value"] / 198e3 - 1) < 0.02, f"E {found['E']['value']:.0f} (198000)")
    end()


if __name__ == "__main__":
    main()
