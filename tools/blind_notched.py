#!/usr/bin/python3
"""Blind trials of `imic3d loop` on another specimen than tools/blind_plate.py's: a plate with two notches, one higher than the other, which
CalculiX pulls, or pulls, unloads and compresses, on a mesh of its own (quadratic bricks, the whole plate). Its material hardens linearly,
by isotropic or, too, by kinematic hardening; isotropic hardening is what is declared. Images as those of that command.

tools/blind_notched.py [--only NAME,NAME] [--seeds N] [--nulls N] [--out FOLDER] [--imic3d PROGRAM]

Writes FOLDER/trials.csv (one line a trial), FOLDER/table.md and prints the table. A trial whose result is there is not run again."""

import argparse
from pathlib import Path

import numpy as np

import blind
import blind_plate
import calculix as cx

TRUTH = dict(E=198e3, S_y=300.0, H=2000.0)
NU, KINEMATIC = 0.25, 3000.0  # Poisson's ratio; modulus of kinematic hardening, where there is any [MPa]
FINE, DECLARED = (0.4, 1.0), (0.8, 2.0)  # sizes of elements at the notches and far from them [mm]
INCREMENT = 2e-3  # largest of CalculiX, mean strain
# Mean strain of the frames between the grips.
WAYS = {
    "pulled": np.interp(np.linspace(0.0, 1.0, 16), np.linspace(0.0, 1.0, 5), [2e-4, 1e-3, 3e-3, 1e-2, 2.4e-2]),
    "cycled": np.array([0.4, 0.8, 1.2, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 9.3, 8.5, 7.5, 6.5, 5.0, 3.0, 1.0]) * 1e-3,
}
# (name in the library, how the plate is loaded, what is planted)
EFFECTS = [
    ("kinematic", "cycled", dict(kinematic=True)),
    ("magnification drift", "pulled", dict(magnification_drift=3e-4)),
    ("magnification drift", "cycled", dict(magnification_drift=3e-4)),
    ("camera bump", "cycled", dict(bump=3e-4)),
    ("force zero", "cycled", dict(force_offset=40.0)),
    ("delay of the force", "cycled", dict(force_delay=0.4)),
]
FOUND_AS = {"magnification drift": "magnification_drift", "camera bump": "step_of_magnification", "force zero": "force_offset", "delay of the force": "force_delay"}


def mesh(path, order, length, sizes):
    """The plate's quadrilaterals."""
    blind_plate.gmsh("double_notch", path, order, length=length, size_notch=sizes[0], size_far=sizes[1])


def quadrilaterals(path):
    """Nodes (n, 2) and quadratic quadrilaterals (m, 8), counter-clockwise, of a mesh of second order."""
    lines = path.read_text().splitlines()
    table = lambda name: [line.split() for line in lines[lines.index(f"${name}") + 2:lines.index(f"$End{name}")]]
    nodes = np.array([row[1:3] for row in table("Nodes")], float)
    cells = np.array([row[3 + int(row[2]):] for row in table("Elements") if row[1] == "16"], int) - 1
    used, cells = np.unique(cells, return_inverse=True)
    nodes, cells = nodes[used], cells.reshape(-1, 8)
    a, b = nodes[cells[:, 2]] - nodes[cells[:, 0]], nodes[cells[:, 3]] - nodes[cells[:, 1]]
    turned = a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0]
    cells[turned] = cells[turned][:, [0, 3, 2, 1, 7, 6, 5, 4]]
    return nodes, cells


def material(kinematic):
    line = lambda slope: f"{TRUTH['S_y']}, 0.\n{TRUTH['S_y'] + 2.0 * slope}, 2.\n"
    plastic = f"*PLASTIC, HARDENING=COMBINED\n{line(KINEMATIC)}*CYCLIC HARDENING\n" if kinematic else "*PLASTIC\n"
    return f"*MATERIAL, NAME=M\n*ELASTIC\n{TRUTH['E']}, {NU}\n{plastic}{line(TRUTH['H'])}"


def simulate(folder, way, kinematic):
    """The front face: nodes (n, 2), faces (m, 8), displacement (frames + 1, n, 3), force (frames + 1); half of the thickness, one brick."""
    length, half = blind_plate.LENGTH, blind_plate.THICKNESS / 2.0
    folder.mkdir(parents=True, exist_ok=True)
    mesh(folder / "mesh.msh", 2, length, FINE)
    face, quads = quadrilaterals(folder / "mesh.msh")
    corner = np.unique(quads[:, :4])
    behind, between, front = np.arange(len(face)), np.empty(len(face), int), len(face) + len(corner) + np.arange(len(face))
    between[corner] = len(face) + np.arange(len(corner))
    nodes = np.concatenate([np.column_stack([at, np.full(len(at), z)]) for at, z in ((face, 0.0), (face[corner], half / 2.0), (face, half))])
    cells = np.column_stack([behind[quads[:, :4]], front[quads[:, :4]], behind[quads[:, 4:]], front[quads[:, 4:]], between[quads[:, :4]]])
    sets = {"TOP": cx.where(nodes[:, 1] > length / 2 - 1e-6), "BOTTOM": cx.where(nodes[:, 1] < 1e-6 - length / 2), "MIDDLE": cx.where(nodes[:, 2] < 1e-9), "FRONT": front + 1}
    deck = [cx.mesh_cards(nodes, cells), *(cx.set_cards("NSET", *item) for item in sets.items()), material(kinematic), "*BOUNDARY\nMIDDLE, 3, 3\nTOP, 1, 1\nBOTTOM, 1, 1\n"]
    output = "*NODE PRINT, NSET=FRONT, FREQUENCY=1000\nU\n*NODE PRINT, NSET=TOP, TOTALS=ONLY, FREQUENCY=1000\nRF\n"
    for before, strain in zip([0.0, *WAYS[way]], WAYS[way]):
        ends = f"*BOUNDARY\nTOP, 2, 2, {strain * length / 2:.12g}\nBOTTOM, 2, 2, {-strain * length / 2:.12g}\n"
        deck.append(cx.step_cards(ends, output, int(np.ceil(abs(strain - before) / INCREMENT - 1e-9))))
    table, seconds = cx.run("".join(deck), folder, "notched")
    print(f"ccx: {len(cells)} elements, {len(WAYS[way])} frames, {seconds:.0f} s", flush=True)
    rows = table["displacements", "FRONT"]
    moved = np.zeros((len(WAYS[way]) + 1, len(nodes), 3))
    moved[1:, rows[0, :, 0].astype(int) - 1] = rows[:, :, 1:]
    return face, quads, moved[:, front], np.concatenate([[0.0], 2.0 * table["total force", "TOP"][:, 0, 1]])


class Notched:
    """What blind_plate.make asks of a specimen."""

    def __init__(self, folder, way, kinematic):
        self.folder, self.way, self.kinematic = folder, way, kinematic

    def __call__(self, *_):
        name = self.way + "_kinematic" * self.kinematic
        file = self.folder / f"{name}.npz"
        if not file.exists():
            np.savez(file, **dict(zip(("nodes", "faces", "displacement", "force"), simulate(self.folder / name, self.way, self.kinematic))))
        known = np.load(file)
        return known["nodes"], known["faces"], known["displacement"], known["force"]

    @staticmethod
    def declared_mesh(path, kind, sizes):
        mesh(path, 1, blind_plate.DECLARED_LENGTH, sizes or DECLARED)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--nulls", type=int, default=2, help="of each way of loading")
    parser.add_argument("--only", default="", help="effects, with commas between them")
    parser.add_argument("--out", type=Path, default=Path("runs/blind_notched"))
    parser.add_argument("--imic3d", default="build/release/imic3d")
    options = parser.parse_args()
    blind_plate.DECLARED["linear"] = ("linear", "E: 190e3, nu: {nu}, S_y: 290, H: 1800", "E, S_y, H")

    def make(folder, planted, seed):
        its = dict(planted)
        specimen = Notched(options.out / "calculix", its.pop("way"), its.pop("kinematic", False))
        blind_plate.make("images", specimen, folder, its | {"declared": "linear"}, seed)

    (options.out / "calculix").mkdir(parents=True, exist_ok=True)
    suite = blind.Suite(options.out, options.imic3d, make, TRUTH)
    only = set(filter(None, options.only.split(",")))
    for way in WAYS:
        for seed in range(options.nulls):
            suite.trial("null", way, "0", {"way": way}, 1 + seed)
    for name, way, planted in EFFECTS:
        for seed in range(options.seeds if not only or name in only else 0):
            suite.trial("effect", name, way, planted | {"way": way}, 1 + seed, FOUND_AS.get(name))
    suite.report()


if __name__ == "__main__":
    main()
