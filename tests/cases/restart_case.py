"""A small virtual test for the tests that stop a run and let it go on."""
import json

from runs import SMALL_PLATE, SMALL_TEST, gmsh, run

PLACE = "{origin: [149.5, 164.5]}"
IDENTIFY = """
loads: {{file: made/loads.csv, noise: 5}}
dic: {{brightness: true}}
identify:
  held_out: 6
  eta: {eta}
  stages:
    - {{free: [E], frames: "2-4"}}
    - {{free: [S_y, H], frames: "2-7"}}
output: {output}
"""


def make(program, folder):
    """Meshes, images and load record."""
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.8, size_far=2.0)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    gmsh("plate_with_hole", folder / "long.msh", length=20, size_hole=0.4, size_far=1.2)  # takes longer
    (folder / "virtual.yaml").write_text(SMALL_PLATE.format(mesh="fine", layers=1, place=PLACE, images="", E=198e3, S_y=284) + SMALL_TEST)
    run(program, "virtual", folder / "virtual.yaml", 1)


def case(folder, name, mesh="coarse", eta=1e-3, S_y=265):
    """A case file that identifies E, then S_y and H, into a folder of the same name."""
    path = folder / f"{name}.yaml"
    path.write_text(SMALL_PLATE.format(mesh=mesh, layers=1, place=PLACE, images=", images: 'made/images/*.png', reference: 0-1", E=185e3, S_y=S_y) +
                    IDENTIFY.format(output=name, eta=eta))
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
