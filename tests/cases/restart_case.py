"""A small virtual test for the tests that stop a run and let it go on."""
import json
import shutil

import numpy
from PIL import Image

from runs import SMALL_PLATE, SMALL_TEST, gmsh, run

PLACE = "{origin: [149.5, 164.5]}"
IDENTIFY = """
loads: {{file: {made}/loads.csv, noise: 5}}
dic: {{brightness: true{dic}}}
identify:
{more}  held_out: 6
  eta: {eta}
  stages:
    - {{free: [E], frames: "2-4"}}
    - {{free: [S_y, H], frames: "2-7"}}
output: {output}
"""

# What else is restarted than the plain case: keys of `identify`, three cameras on both faces, or images with a loose patch of paint.
VARIANTS = {
    "perturbed": "  sensitivities: perturbed\n",
    "alpha": "  alpha: 0.01\n",
    "cameras": "",
    "paint": "",
}
THREE_CAMERAS = """
  - {{name: mono, pixel_size: 0.08, place: {place}{mono}}}
  - {{name: left, model: pinhole, face: back{left}}}
  - {{name: right, model: pinhole, face: back{right}}}
"""


def three_cameras(**of):
    """The case with three cameras instead of one."""
    one = "\n  - {{name: front, pixel_size: 0.08, place: {place}{images}}}\n"
    assert one in SMALL_PLATE
    return SMALL_PLATE.replace(one, THREE_CAMERAS.format(place=PLACE, **of).replace("{", "{{").replace("}", "}}")).replace("loaded: top}}", "loaded: top{at}}}")


def make_three_cameras(program, folder):
    """Their images, on the meshes of `make`."""
    text = three_cameras(mono=", size: [300, 330]", left=", size: [330, 350], view: {focal: 5600, from: [-85, 0, -395], at: [0, 0, -4], distortion: [0.05, 0, 0.001]}",
                         right=", size: [330, 350], view: {focal: 5600, from: [85, 4, -395], at: [0, 0, -4], roll: 1}")
    test = SMALL_TEST.replace("size: [300, 330], ", "").replace("made", "three")
    (folder / "virtual_three.yaml").write_text(text.format(mesh="fine", layers=1, at="", E=198e3, S_y=284) + test)
    run(program, "virtual", folder / "virtual_three.yaml", 1)


def make_loose_paint(folder):
    """The images of `make`, in the last four of which another part of the picture covers a round place of the specimen."""
    images = sorted((folder / "made/images").glob("*.png"))
    (folder / "loose").mkdir()
    for image in images[:-4]:
        shutil.copy(image, folder / "loose")
    for image in images[-4:]:
        grey = numpy.array(Image.open(image))
        rows, columns = numpy.mgrid[:grey.shape[0], :grey.shape[1]]
        place = (columns - 190)**2 + (rows - 250)**2 < 18**2
        grey[place] = numpy.roll(grey, (-60, -80), (0, 1))[place]
        Image.fromarray(grey).save(folder / "loose" / image.name)


def make(program, folder):
    """Meshes, images and load record."""
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.8, size_far=2.0)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    gmsh("plate_with_hole", folder / "long.msh", length=20, size_hole=0.4, size_far=1.2)  # takes longer
    (folder / "virtual.yaml").write_text(SMALL_PLATE.format(mesh="fine", layers=1, place=PLACE, images="", E=198e3, S_y=284) + SMALL_TEST)
    run(program, "virtual", folder / "virtual.yaml", 1)


def case(folder, name, mesh="coarse", eta=1e-3, S_y=265, variant=None, more="", dic_groups="auto"):
    """A case file that identifies E, then S_y and H, into a folder of the same name; `more`: further keys of `identify`."""
    path = folder / f"{name}.yaml"
    more = VARIANTS.get(variant, "") + more
    if variant == "cameras":
        points = json.loads((folder / "three/truth.json").read_text())["place_points"]["left"]
        back = ", calibration: three/calibration_back.yaml, images: 'three/images_{}/*.png', reference: 0-1"
        text = three_cameras(mono=", images: 'three/images_mono/*.png', reference: 0-1", left=back.format("left"), right=back.format("right"))
        path.write_text(text.format(mesh=mesh, layers=1, at=f", place: {{camera: left, points: {points}}}", E=185e3, S_y=S_y) +
                        IDENTIFY.format(output=name, eta=eta, made="three", more=more, dic=f", groups: {dic_groups}"))
        return path
    images = "loose" if variant == "paint" else "made/images"
    path.write_text(SMALL_PLATE.format(mesh=mesh, layers=1, place=PLACE, images=f", images: '{images}/*.png', reference: 0-1", E=185e3, S_y=S_y) +
                    IDENTIFY.format(output=name, eta=eta, made="made", more=more, dic=f", groups: {dic_groups}"))
    return path


def parameters(output):
    """Name -> value of everything that a result.json says of the parameters, and of their standard deviations."""
    result = json.loads((output / "result.json").read_text())
    values = {name: entry["value"] for name, entry in result["parameters"].items()}
    return values, {name: entry["standard_deviation"] for name, entry in result["parameters"].items() if entry["standard_deviation"]}


def difference(output, truth):
    """Largest relative difference of the parameters of two results, and of their standard deviations."""
    found, deviation = parameters(output)
    values, deviations = truth
    return (max(abs(found[name] / values[name] - 1.0) for name in values if values[name]),
            max(abs(deviation[name] / deviations[name] - 1.0) for name in deviations))
