#!/usr/bin/python3
"""Every command on a small virtual test with 2 ranks; the identification also with 1 and 3, with equal results.

Usage: smoke.py EXECUTABLE
"""
import json
import sys

import h5py
import numpy
from PIL import Image

from runs import SMALL_PLATE as CASE, SMALL_TEST as GENERATE, end, gmsh, left_behind, require, run, same_page, workspace

IDENTIFY = """
loads: {{file: made/loads.csv, noise: 5}}
dic: {{brightness: true}}
identify:
  functional: {functional}
  held_out: 6
  stages:
    - {{free: [E], frames: "2-4"}}
    - {{free: [S_y], frames: "2-7"}}
output: {output}
"""


def main():
    program = sys.argv[1]
    folder = workspace("smoke")
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.6, size_far=1.6)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    origin = "{origin: [149.5, 164.5]}"
    (folder / "virtual.yaml").write_text(
        CASE.format(mesh="fine", layers=2, place=origin, images="", E=198e3, S_y=284) + GENERATE)

    (folder / "simulated").mkdir()
    (folder / "simulated/log.txt").symlink_to("/dev/full")
    run(program, "simulate", folder / "virtual.yaml", 2, ["--output", str(folder / "simulated")])  # a full disk takes the log alone
    run(program, "virtual", folder / "virtual.yaml", 2)
    images = sorted((folder / "made/images").glob("*.png"))
    require(len(images) == 8, f"8 images were made ({len(images)})")
    truth = json.loads((folder / "made/truth.json").read_text())
    require(truth["S_y"] == 284, "truth.json has the true values")
    with h5py.File(folder / "simulated/results.h5") as a, h5py.File(folder / "made/results.h5") as b:
        require(numpy.allclose(a["fields/displacement"][1:], b["fields/displacement"][1:], rtol=0, atol=1e-10),
                "simulate and virtual compute the same path")

    cases = {}
    for functional, output in (("force_driven", "force"), ("displacement_driven", "displacement"), ("combined", "combined")):
        cases[functional] = folder / f"{functional}.yaml"
        cases[functional].write_text(
            CASE.format(mesh="coarse", layers=1, place="{auto: outline}", images=", images: 'made/images/*.png', reference: 0-1",
                        E=185e3, S_y=265) + IDENTIFY.format(functional=functional, output=output))
    plan = run(program, "check", cases["force_driven"], 2)
    require("stage 2" in plan and "unknowns" in plan, "check prints the plan")
    run(program, "dic", cases["force_driven"], 2, ["--output", str(folder / "dic")])
    with h5py.File(folder / "dic/results.h5") as file:
        rms = file["residual/rms_dic"][2:]
        require(numpy.all(rms < 5.0), f"the correlation leaves noise ({numpy.nanmax(rms):.2f} grey levels at most)")

    values = {}
    for ranks in (1, 2, 3):
        run(program, "identify", cases["force_driven"], ranks, ["--output", str(folder / f"force_{ranks}")])
        result = json.loads((folder / f"force_{ranks}/result.json").read_text())
        values[ranks] = numpy.array([result["parameters"][name]["value"] for name in ("E", "S_y")])
    for ranks in (2, 3):
        difference = numpy.max(numpy.abs(values[ranks] / values[1] - 1.0))
        require(difference < 1e-8, f"{ranks} ranks and 1 identify the same ({difference:.1e})")
    stages = json.loads((folder / "force_1/result.json").read_text())["stages"]
    require(all(one["steps_per_frame"] > 1 for one in stages), f"more load increments were asked what one a frame errs by ({[one['steps_per_frame'] for one in stages]})")
    shares = stages[1]["standard_deviation"]["S_y"]
    require(0 < shares["images"] < shares["force"] < shares["total"] and shares["boundary"] > 0, f"the noise of the load record is in the standard deviation, and is most of it ({shares})")
    require(abs(values[1][0] / 198e3 - 1) < 0.05 and abs(values[1][1] / 284 - 1) < 0.03,
            f"E {values[1][0]:.0f} (198000), S_y {values[1][1]:.2f} (284), coarse mesh")
    for functional, output in (("displacement_driven", "displacement"), ("combined", "combined")):
        run(program, "identify", cases[functional], 2)
        result = json.loads((folder / output / "result.json").read_text())
        E, S_y = (result["parameters"][name]["value"] for name in ("E", "S_y"))
        require(abs(E / 198e3 - 1) < 0.05 and abs(S_y / 284 - 1) < 0.03, f"{functional}: E {E:.0f}, S_y {S_y:.2f}")

    # What a run in space says of a mesh that is refined once is what such a run finds.
    at_once = cases["displacement_driven"].read_text().replace('    - {free: [E], frames: "2-4"}\n    - {free: [S_y], frames: "2-7"}', '    - {free: [E, S_y], frames: "2-7"}')
    found = {}
    for name, layers in (("once", "layers: 1"), ("refined", "layers: 1, refine: 1")):
        (folder / f"{name}.yaml").write_text(at_once.replace("layers: 1", layers).replace("output: displacement", f"output: {name}"))
        run(program, "identify", folder / f"{name}.yaml", 2)
        found[name] = json.loads((folder / name / "result.json").read_text())
    for name, one in ((name, found["once"]["parameters"][name]) for name in ("E", "S_y")):
        said, is_so = one["refined_mesh"]["change"], found["refined"]["parameters"][name]["value"] - one["value"]
        require(abs(said - is_so) < 0.3 * abs(is_so) + one["standard_deviation"], f"a mesh refined once: {name} {said:+.4g} said, {is_so:+.4g} found, standard deviation {one['standard_deviation']:.2g}")
    far = any(abs(one["refined_mesh"]["change"]) > one["standard_deviation"] for one in found["once"]["parameters"].values() if "refined_mesh" in one)
    require(any("the mesh is coarse" in doubt for doubt in found["once"].get("doubts", [])) == far, f"and doubted where that is more than a standard deviation: {far}")

    alone = json.loads((folder / "displacement/result.json").read_text())["parameters"]
    require(all(alone[name]["at_once"]["standard_deviation"] > 0 for name in ("E", "S_y")) and "at_once" not in alone["H"], f"what E and S_y, found one after another, would change by is there ({alone['S_y']['at_once']})")
    in_turn = folder / "in_turn.yaml"
    in_turn.write_text(cases["force_driven"].read_text().replace("H: 1480", "H: 1000").replace('{free: [S_y], frames: "2-7"}', '{free: [S_y], frames: "2-7"}\n    - {free: [H], frames: "2-7"}').replace("output: force", "output: in_turn"))
    said = run(program, "identify", in_turn, errors=True)
    result = json.loads((folder / "in_turn/result.json").read_text())
    found, doubts = result["parameters"], [doubt for doubt in result.get("doubts", []) if "one after another" in doubt]
    change = found["S_y"]["at_once"]
    require(found["H"]["initial"] == 1000 and abs(change["change"]) > 2 * change["standard_deviation"] and len(doubts) == 1 and "S_y by" in doubts[0] and "Free at once" in said,
            f"S_y and H, found one after another, are doubted: {found['S_y']}, {found['H']}, {doubts}")
    require(abs(found["S_y"]["value"] + change["change"] - 284) < 0.5 * abs(found["S_y"]["value"] - 284), f"it would go to the truth ({found['S_y']['value'] + change['change']:.2f})")
    page = (folder / "in_turn/report.html").read_text()
    require("change, all free at once" in page and "Free at once" in page, "and the page says so")

    bounded = folder / "bounded.yaml"
    bounded.write_text(cases["displacement_driven"].read_text().replace("S_y: 265", "S_y: {value: 265, upper: 270}").replace("output: displacement", "output: bounded"))
    said = run(program, "identify", bounded)
    result = json.loads((folder / "bounded/result.json").read_text())
    require(any("of the force" in doubt and "times its noise" in doubt for doubt in result["doubts"]), f"what it leaves of the force is doubted: {result['doubts']}")
    run(program, "report", folder / "bounded/results.h5", 1, ["--output", str(folder / "report_bounded")])
    for page in (folder / "bounded/report.html", folder / "report_bounded/report.html"):
        require("Doubted:" in page.read_text() and "times its noise" in page.read_text(), f"and its page says so ({page.parent.name})")
    result = json.loads((folder / "displacement/result.json").read_text())
    others = [doubt for doubt in result.get("doubts", []) if "the mesh is coarse" not in doubt]
    require(not others, f"nothing is where it may be what it is, but for the mesh: {others}")
    found = json.loads((folder / "bounded/result.json").read_text())["parameters"]
    require(found["S_y"]["on_bound"] and 269.7 < found["S_y"]["value"] <= 270 and not found["E"]["on_bound"] and "(on its bound)" in said and "on its bound" in (folder / "bounded/report.html").read_text(),
            f"a yield stress of 284 that may be 270 at most is on its bound: {found['S_y']}")
    require(not any(one["on_bound"] for one in result["parameters"].values()), "those that may be what they are, are on none")

    hasty = folder / "hasty.yaml"
    hasty.write_text(cases["displacement_driven"].read_text().replace("identify:", "identify:\n  max_iterations: 1").replace("output: displacement", "output: hasty"))
    said = run(program, "identify", hasty, 2, status=3, errors=True)
    doubts = json.loads((folder / "hasty/result.json").read_text())["doubts"]
    require("stage 1 did not converge in 1 iterations: eta is still" in said and any("stage 1 did not converge" in doubt for doubt in doubts) and "stage 1 did not converge" in (folder / "hasty/report.html").read_text(),
            f"a stage that did not converge is doubted, and the status says so: {doubts}")

    unseen = folder / "unseen.yaml"
    unseen.write_text(cases["displacement_driven"].read_text().replace("S_y: 265", "S_y: 2650").replace("free: [E]", "free: [E, S_y]").replace("output: displacement", "output: unseen")
                      .replace('\n    - {free: [S_y], frames: "2-7"}', ""))
    said = run(program, "identify", unseen)
    result = json.loads((folder / "unseen/result.json").read_text())
    found = result["parameters"]
    require(found["S_y"]["value"] == 2650 and found["S_y"]["standard_deviation"] is None and found["S_y"]["determined"] is False and found["E"]["standard_deviation"] > 0
            and "(not determined)" in said and "not determined" in (folder / "unseen/report.html").read_text() and any(doubt.startswith("S_y not determined") for doubt in result["doubts"]),
            f"a yield stress that no frame shows is not determined: {found['S_y']}")
    backwards = folder / "backwards.yaml"
    backwards.write_text(cases["displacement_driven"].read_text().replace("noise: 5", "noise: 5, force_scale: -1").replace("output: displacement", "output: backwards"))
    said = run(program, "identify", backwards, 2, status=2, errors=True)
    require("loads.force: a change of -" in said and "by +" in said, f"a force that pushes where the specimen lengthens is refused: {said.splitlines()[-1]}")
    plain, light = folder / "dic_plain.yaml", folder / "dic_light.yaml"
    plain.write_text(cases["displacement_driven"].read_text().replace("dic: {brightness: true}", "dic: {low_pass: 1}"))
    (folder / "drifting").mkdir()
    for t, name in enumerate(images):
        grey = numpy.asarray(Image.open(name), float)
        Image.fromarray(numpy.clip(numpy.rint(grey * (1 - 0.03 * max(0, t - 1))), 0, 255).astype(numpy.uint8)).save(folder / "drifting" / name.name)
    light.write_text(plain.read_text().replace("made/images/", "drifting/"))
    for case, changes in ((plain, False), (light, True)):
        run(program, "dic", case, 2, ["--output", str(folder / case.stem)])
        doubts = json.loads((folder / case.stem / "result.json").read_text()).get("doubts", [])
        require(any("the light changes" in doubt for doubt in doubts) == changes, f"{case.stem}: light that drifts is doubted, and no other: {doubts}")

    run(program, "report", folder / "force_1/results.h5", 2, ["--output", str(folder / "report")])
    page = (folder / "report/report.html").read_text()
    require("S_y" in page and "data:image/png;base64" in page, "the report has the parameters and its pictures")
    left_behind(folder / "force_1", cases["force_driven"], "identify")
    left_behind(folder / "made", folder / "virtual.yaml", "virtual")
    log = (folder / "force_1/log.txt").read_text()
    require("stage 2: S_y" in log and "simulations: " in log, "the log has what the run said")
    same_page(program, folder / "force_1")
    with h5py.File(folder / "force_1/results.h5") as file:
        for name in ("fields/displacement", "fields/plastic_strain", "dic/displacement", "residual/element_model",
                     "identification/covariance", "case/text", "frames/force_predicted"):
            require(name in file, f"results.h5 has {name}")
        require(int(file["frames/use"][6]) == 2, "the held-out frame is marked")
        require(numpy.isfinite(file["residual/rms_model"][6]), "the held-out frame is predicted")
    end()


main()
