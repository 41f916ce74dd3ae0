#!/usr/bin/python3
"""`imic3d loop` on a plate with a hole of which a part, between the places where the loop begins to look, is weaker or stronger than the rest: it is named, with its place. So is a camera that
is pushed at one moment or another. Images of imic3d virtual: longer plate, finer mesh, more increments, noise, 8 bits.

Usage: loop_region.py EXECUTABLE
"""
import json
import sys

from runs import end, gmsh, require, run, workspace

LAW = "{{law: j2, hardening: power_linear, tie_initial_modulus: true, parameters: {{E: {}, nu: 0.25, S_y: {}, H: {}, delta: 0.042}}}}"
TRUE, DECLARED = LAW.format(198e3, 284, 1480), LAW.format(190e3, 278, 1420)
SOFT = {"region": -0.08, "region_x": 0.68, "region_y": 0.30, "region_radius": 0.13}
HARD = {"region": 0.1, "region_x": 0.3, "region_y": 0.7, "region_radius": 0.2}
VIRTUAL = f"""
title: Plate of which something is not declared
specimen: {{mesh: long.msh, kinematics: plane_stress, refine: 2, element: quad8, thickness: 0.8, held: bottom, loaded: top}}
cameras: [{{name: front, pixel_size: 0.09, place: {{origin: [124.5, 159.5]}}}}]
material: {TRUE}
simulate: {{control: displacement, clamped: true, centred: true, steps_per_frame: 16, value: [0, 0.012, 0.03, 0.048, 0.06, 0.09, 0.12, 0.15, 0.22, 0.3, 0.44, 0.6, 0.8, 1.0, 1.2, 1.4]}}
virtual: {{size: [250, 320], speckle_size: 5, noise: 0.01, load_noise: 2, static_frames: 5, seed: SEED, directory: test, declared_mesh: plate.msh}}
effects: EFFECTS
output: test
"""
LOOP = f"""
title: Plate, the rest unknown
specimen: {{mesh: plate.msh, kinematics: plane_stress, element: quad8, thickness: 0.8, held: bottom, loaded: top}}
cameras: [{{name: front, pixel_size: 0.09, place: {{origin: [124.5, 159.5]}}, images: "test/images/*.png", reference: 0-4}}]
loads: {{file: test/loads.csv, image: frame, time: time_s, force: force_N, noise: 2}}
material: {DECLARED}
identify: {{functional: displacement_driven, stages: [{{free: [E, S_y, H, delta]}}]}}
loop: {{draws: 60, rivals: 2, additions: 2, starts: [1.0]}}
output: run
"""


def main():
    program = sys.argv[1]

    def trial(effect, planted, seed):
        folder = workspace("loop_region")
        gmsh("plate_with_hole", folder / "long.msh", length=40, size_hole=1.6, size_far=2.5)
        gmsh("plate_with_hole", folder / "plate.msh", length=24, size_hole=1.6, size_far=4.0)
        (folder / "virtual.yaml").write_text(VIRTUAL.replace("SEED", str(seed)).replace("EFFECTS", json.dumps({effect.replace(" ", "_"): planted})))
        (folder / "loop.yaml").write_text(LOOP)
        run(program, "virtual", folder / "virtual.yaml", 2)
        run(program, "loop", folder / "loop.yaml", 2)
        result = json.loads((folder / "run/result.json").read_text())
        chi = result["after"]["chi"]
        print(f"{effect}, {planted}: chi {result['before']['chi']['fitted']:.2f} -> {chi['fitted']:.2f} (null {chi['null_fitted']:.2f})\n  {result['sentence']}", flush=True)
        require(result["verdict"] == "attributed" and result["named"] == [effect], f"{result['verdict']}: {result['named']}, set {result['set']}")
        require(chi["held_out"] < 1.05 * chi["null_held_out"], f"held out {chi['held_out']:.2f} (null {chi['null_held_out']:.2f})")
        found = result["after"]["parameters"]
        require(abs(found["E"]["value"] / 198e3 - 1) < 0.02, f"E {found['E']['value']:.0f} (198000)")
        return {name: (found.get(name, {"value": 0.0, "standard_deviation": 0.0})["value"], found.get(name, {"value": 0.0, "standard_deviation": 0.0})["standard_deviation"]) for name in planted}

    # Elements of 4 mm, in which the strength is one number each, tell the middle of a spot of 2.6 mm to half a millimetre or so of the 20 x 24 mm, and little of depth and radius but their product.
    for seed in (1, 3):
        found = trial("stiff or soft region", SOFT, seed)
        for name, allowed in (("region_x", 0.06), ("region_y", 0.03)):
            require(abs(found[name][0] - SOFT[name]) < allowed, f"{name} {found[name][0]:.3f} +- {found[name][1]:.3f} ({SOFT[name]})")
        strength = found["region"][0] * found["region_radius"][0] ** 2 / (SOFT["region"] * SOFT["region_radius"] ** 2)
        require(abs(strength - 1) < 0.25, f"region times radius squared over what it is: {strength:.3f}")
    for name, (value, deviation) in trial("stiff or soft region", HARD, 2).items():
        require(abs(value - HARD[name]) < 4 * deviation < 0.2 * HARD[name], f"{name} {value:.4f} +- {deviation:.4f} ({HARD[name]})")
    for onset in (0.17, 0.37):
        pushed = {"step_of_magnification": 5e-4, "tilt_x": 2e-5, "bump_onset": onset}
        found = trial("camera bump", pushed, 4)
        for name in ("step_of_magnification", "tilt_x"):
            value, deviation = found[name]
            require(abs(value - pushed[name]) < 4 * deviation < 0.25 * pushed[name], f"{name} {value:.3g} +- {deviation:.1g} ({pushed[name]})")
        require(int(15 * found["bump_onset"][0]) == int(15 * onset), f"pushed at {found['bump_onset'][0]:.3f}, between the frames where it was planted ({onset})")
    end()


if __name__ == "__main__":
    main()
