#!/usr/bin/python3
"""`imic3d loop` with a telecentric camera on each face of an elastic bar: with nothing missing nothing is found; a load that is eccentric through the thickness,
which one camera could not see, is named; a drift of the magnification of the rear camera is named with its camera. Images of imic3d virtual: longer bar, finer
mesh, other elements, noise, 8 bits.

Usage: loop_faces.py EXECUTABLE [--stereo] [--few] [--ranks 2]      --stereo: two pinhole cameras on the back; --few: without the drift
"""
import json
import sys

import h5py
import numpy

from runs import bar, end, ranks_of, require, run, workspace

CAMERAS = {
    "front": "{{name: mono, pixel_size: 0.08, place: {{origin: [65, 170]}}, size: [131, 341]{mono}}}",
    "back": "{{name: rear, face: back, pixel_size: 0.075, place: {{origin: [68, 180]}}, size: [137, 361]{rear}}}",
    "left": "{{name: left, model: pinhole, face: back, size: [150, 380], {left}}}",
    "right": "{{name: right, model: pinhole, face: back, size: [150, 380], {right}}}",
}
LENSES = {"left": "view: {focal: 5600, from: [-85, 0, -395], at: [0, 0, -2], distortion: [0.05, 0, 0.001]}",
          "right": "view: {focal: 5600, from: [85, 4, -395], at: [0, 0, -2], roll: 1}"}
VIRTUAL = """
title: Bar seen from both sides
specimen: {{mesh: long.msh, thickness: 2, layers: 3, element: hex20, held: bottom, loaded: top}}
cameras: [{cameras}]
material: {{law: elastic, parameters: {{E: 200e3, nu: 0.3}}}}
simulate: {{value: [0, 0.008, 0.016, 0.024, 0.032, 0.04, 0.028, 0.014, 0.026, 0.04]}}
virtual: {{noise: 0.004, load_noise: 5, static_frames: 3, directory: {name}, declared_mesh: bar.msh, seed: {seed}}}
effects: {effects}
output: {name}
"""
LOOP = """
title: Bar seen from both sides
specimen: {{mesh: bar.msh, thickness: 2, layers: 2, mid_plane_symmetry: {half}, held: bottom, loaded: top{place}}}
cameras: [{cameras}]
loads: {{file: {name}/loads.csv, noise: 5}}
material: {{law: elastic, parameters: {{E: 190e3, nu: 0.28}}}}
identify: {{functional: displacement_driven, stages: [{{free: [E, nu]}}]}}
loop: {{draws: 40, modes: 30, additions: 1, rivals: {rivals}, starts: [1.0]}}
effects: {effects}
output: {output}
"""
E, NU = 200e3, 0.3


def main():
    program, stereo, ranks = sys.argv[1], "--stereo" in sys.argv, ranks_of(sys.argv)
    folder = workspace("loop_faces")
    bar(folder / "long.msh", -16.0, 16.0, 40, columns=10)
    bar(folder / "bar.msh", -11.0, 11.0, 15, columns=6)
    seen = ["front", "left", "right"] if stereo else ["front", "back"]

    def make(name, seed, effects="{}"):
        cameras = ", ".join(CAMERAS[c].format(mono="", rear="", **{k: v for k, v in LENSES.items()}) for c in seen)
        (folder / f"{name}_virtual.yaml").write_text(VIRTUAL.format(cameras=cameras, name=name, seed=seed, effects=effects))
        run(program, "virtual", folder / f"{name}_virtual.yaml", ranks)

    def loop(name, cameras=seen, half="false", effects="{}", status=0, output=None, command="loop"):
        place = ""
        images = lambda c: f"images: '{name}/images_{c}/*.png', reference: 0-2"
        text = {"mono": ", " + images("mono"), "rear": ", " + images("rear")}
        for side in ("left", "right"):
            text[side] = f"calibration: {name}/calibration_back.yaml, " + images(side)
        if "left" in cameras:
            points = json.loads((folder / name / "truth.json").read_text())["place_points"]["left"]
            place = f", place: {{camera: left, points: {points}}}"
        declared = ", ".join(CAMERAS[c].format(**text) for c in cameras)
        case = folder / f"{name}_{output or 'loop'}.yaml"
        case.write_text(LOOP.format(half=half, place=place, cameras=declared, name=name, effects=effects, rivals=2 if stereo else 1, output=f"{name}/{output or 'run'}"))
        said = run(program, command, case, ranks if status == 0 else 1, status=status, errors=status != 0)
        return said if status else json.loads((folder / name / (output or "run") / "result.json").read_text())

    def size_of(result, candidate, quantity):
        return next(t for t in result["rounds"][0]["trials"] if t["candidate"] == candidate)["parameters"][quantity]

    def kappa(result, name):
        return next((one["kappa"] for one in result["before"]["candidates"] if one["name"] == name), 0.0)

    def detectable(result, name):
        return next((one["sizes"][0]["detectable"] for one in result["before"]["candidates"] if one["name"] == name), None) or float("inf")

    def within_null(result, what, factor=1.05):
        chi = result["after"]["chi"]
        require(chi["held_out"] < factor * chi["null_held_out"], f"{what}: held-out chi {result['before']['chi']['held_out']:.2f} -> {chi['held_out']:.2f}, null {chi['null_held_out']:.2f}")
        for face, one in chi["cameras"].items():
            require(one["left_out"] < factor * one["null"], f"{what}: the {face} from the other: chi {result['before']['chi']['cameras'][face]['left_out']:.2f} -> {one['left_out']:.2f}, null {one['null']:.2f}")

    make("nothing", 1)
    both = loop("nothing")
    found = both["before"]["parameters"]
    require(both["verdict"] == "nothing found", f"nothing is missing: {both['sentence']}")
    for name, truth in (("E", E), ("nu", NU)):
        off = (found[name]["value"] - truth) / found[name]["standard_deviation"]
        require(abs(off) < 4, f"{name} {found[name]['value']:.5g} +- {found[name]['standard_deviation']:.2g}, true {truth:g}")
    within_null(both, "nothing missing")
    names = [one["name"] for one in both["before"]["candidates"]] + both["invisible"]
    require("front magnification drift" in names and "back magnification drift" in names and "magnification drift" not in names, "a drift of each face's camera is a candidate")
    require(("back parallax" in names) == (not stereo), "parallax is one of a single camera")
    own = [f"{camera} {effect}" for camera in ("left", "right") for effect in ("camera bump", "lens distortion", "magnification drift")]
    require(all((name in names) == stereo for name in own), f"what one of several cameras errs by is a candidate: {', '.join(own)}")
    for face in ("front", "back"):
        require((folder / f"nothing/run/residual_before_{face}.png").stat().st_size > 500 and (folder / f"nothing/run/zoom_remainder_{face}.png").stat().st_size > 500 and not (folder / f"nothing/run/residual_after_{face}.png").exists() and (folder / f"nothing/run/remainder_{face}.png").stat().st_size > 500, f"pictures of the {face}")
    alone = loop("nothing", ["front"], output="alone")
    # With one face the share is hidden by E, and how the ends move at depth is unknown there: the size that would be found tells both.
    require(kappa(both, "misalignment") > max(0.3, 5 * kappa(alone, "misalignment")) and detectable(alone, "misalignment") > 10 * detectable(both, "misalignment"),
            f"misalignment: kappa {kappa(both, 'misalignment'):.3f} with both faces, {kappa(alone, 'misalignment'):.3f} with one; detectable {detectable(both, 'misalignment'):.3g} and {detectable(alone, 'misalignment'):.3g}")

    share = 0.05
    make("bent", 2, f"{{misalignment: {{bending_share: {share}}}}}")
    # Tension straightens what the ends bend: of the part that is declared (to the nearest nodes) the share is smaller, and the mean counts.
    with h5py.File(folder / "bent/results.h5") as file:
        nodes, u = file["mesh/nodes"][:], file["fields/displacement"][1:, :, 1]
    end_of = lambda y, z: u[:, (numpy.abs(nodes[:, 1] - y) < 1e-6) & (numpy.abs(nodes[:, 2] - z) < 1e-6)].mean(axis=1)
    longer = {z: end_of(11.2, z) - end_of(-11.2, z) for z in (0.0, -2.0)}
    middle = 0.5 * (longer[0.0] + longer[-2.0])
    expected = numpy.sum((longer[0.0] - middle) * middle) / numpy.sum(middle**2)
    result = loop("bent")
    require(result["verdict"] in ("attributed", "ambiguous") and "misalignment" in result["set"], f"{result['verdict']}: {result['set']}")
    size = size_of(result, "misalignment", "bending_share")
    require(abs(size["value"] - expected) < 4 * size["standard_deviation"] + 0.05 * expected, f"bending share {size['value']:.4f} +- {size['standard_deviation']:.1g}, true {expected:.4f}")
    within_null(result, "bent")
    require(all((folder / f"bent/run/{name}_{face}.png").stat().st_size > 500 for name in ("residual_after", "zoom_after") for face in ("front", "back")), "pictures of what was added")

    # Declared as one more unknown, it is identified with the parameters.
    known = loop("bent", effects="{misalignment: {bending_share: {free: true}}}", output="known", command="identify")
    size, chi = known["parameters"]["bending_share"], known["after"]["chi"]
    require(not known["searched"] and chi["fitted"] < chi["null_fitted"] < result["before"]["chi"]["fitted"] and abs(size["value"] - expected) < 4 * size["standard_deviation"] + 0.05 * expected,
            f"identified with it: bending share {size['value']:.4f} +- {size['standard_deviation']:.1g}, chi {chi['fitted']:.2f} (null {chi['null_fitted']:.2f})")

    if stereo:  # one of the two cameras is pushed, which the pair takes for a motion in space
        pushed = 2e-4
        make("pushed", 5, f"{{left_camera_bump: {{step_of_magnification: {pushed}, bump_onset: 0.5}}}}")
        result = loop("pushed")
        # The image of the other camera that shrinks or grows is the same motion, but for a rigid one.
        require("left camera bump" in result["set"] and set(result["set"]) <= {"left camera bump", "right camera bump"}, f"{result['verdict']}: {result['set']}")
        size = size_of(result, "left camera bump", "left_step_of_magnification")
        require(abs(size["value"] - pushed) < 4 * size["standard_deviation"] + 0.05 * pushed, f"push of the left camera {size['value']:.3g} +- {size['standard_deviation']:.1g}, planted {pushed:g}")
        require(result["light"]["verdict"] == "nothing found", f"what the pair does not take for motion is no light: {result['light']['verdict']} {result['light']['set']}")
        within_null(result, "pushed")
        said = loop("nothing", effects="{middle_camera_bump: {step_of_magnification: 1e-3}}", status=2, output="which")
        require("left_camera_bump" in said, "a camera that is not there is refused")
    else:
        if "--few" not in sys.argv:
            drift = 5e-4
            make("drift", 5, f"{{back_magnification_drift: {{magnification_drift: {drift}}}}}")
            result = loop("drift")
            require(result["verdict"] == "attributed" and result["set"] == ["back magnification drift"], f"{result['verdict']}: {result['set']}")
            size = size_of(result, "back magnification drift", "back_magnification_drift")
            require(abs(size["value"] - drift) < 4 * size["standard_deviation"] + 0.05 * drift, f"drift of the rear camera {size['value']:.3g} +- {size['standard_deviation']:.1g}, planted {drift:g}")
            within_null(result, "drift")
        said = loop("nothing", half="true", status=2, output="half")
        require("specimen.mid_plane_symmetry" in said, f"mid-plane symmetry is refused: {said.strip()}")
        said = loop("nothing", effects="{magnification_drift: {magnification_drift: 1e-4}}", status=2, output="which")
        require("front_magnification_drift" in said, "a drift without its face is refused")
    end()


main()
