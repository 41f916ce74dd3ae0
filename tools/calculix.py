"""What the CalculiX commands in this folder share: the law, the plate's mesh, running ccx and reading its table.

Units: mm, N, MPa. Needs CalculiX (`ccx`) and numpy. Nothing here knows of imic3d: it is there to be independent of it.
"""

import argparse
import os
import re
import shutil
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

TABLE_ROWS = 190  # CalculiX holds 200 at most
DONE = "Job finished"  # what ccx prints at the end


@dataclass(frozen=True)
class Law:
    """Isotropic elasticity and the hardening of Eq. (18); eps0 tied by Eq. (19) to make the initial slope equal E."""

    E: float = 198e3
    nu: float = 0.25
    S_y: float = 284.0
    H: float = 1480.0
    delta: float = 0.042

    @property
    def eps0(self):
        return self.delta * self.S_y / (self.E - self.H)  # Eq. (19)

    @property
    def bulk(self):
        return self.E / (3.0 * (1.0 - 2.0 * self.nu))

    @property
    def shear(self):
        return self.E / (2.0 * (1.0 + self.nu))

    def yield_stress(self, p):
        return self.H * p + self.S_y * (1.0 + p / self.eps0) ** self.delta  # Eq. (18)

    def table_strain(self, largest=3.0):
        """Plastic strains even in log(1 + p/eps0): the interpolation error is then the same in every interval."""
        return self.eps0 * np.expm1(np.linspace(0.0, np.log1p(largest / self.eps0), TABLE_ROWS))


@dataclass(frozen=True)
class SaturationLaw:
    """Saturation with a linear part, as used for Cook's membrane (Simo and Armero 1992)."""

    E: float = 206.9
    nu: float = 0.29
    sigma_y: float = 0.45
    sigma_inf: float = 0.715
    delta: float = 16.93
    H: float = 0.12924

    @property
    def bulk(self):
        return self.E / (3.0 * (1.0 - 2.0 * self.nu))

    @property
    def shear(self):
        return self.E / (2.0 * (1.0 + self.nu))

    def yield_stress(self, p):
        return self.sigma_y + (self.sigma_inf - self.sigma_y) * -np.expm1(-self.delta * p) + self.H * p

    def slope(self, p):
        return (self.sigma_inf - self.sigma_y) * self.delta * np.exp(-self.delta * p) + self.H

    def table_strain(self, largest=3.0):
        dense = np.linspace(0.0, 0.6, 150)
        return np.concatenate([dense, np.linspace(0.6, largest, TABLE_ROWS - 149)[1:]])


def interpolation_error(law):
    """Largest relative error of the piecewise linear table against the law, sampled twenty times in each interval."""
    p = law.table_strain()
    fine = np.interp(np.linspace(0, len(p) - 1, 20 * len(p)), np.arange(len(p)), p)
    return np.max(np.abs(np.interp(fine, p, law.yield_stress(p)) / law.yield_stress(fine) - 1.0))


def material_cards(law, theory="simo"):
    """*PLASTIC wants the Cauchy stress against CalculiX's accumulated plastic strain.

    theory "simo": the law is taken as written, in CalculiX's own theory (see docs/verification.md).
    theory "hencky": the table is transformed so that CalculiX's uniaxial tension is that of Hencky elasticity with the
    exponential map and the yield function in Kirchhoff stress, tau = sigma_y(p): the stress is divided by
    J = exp(tau / 3K), and the plastic strain is stretched by 1 + tau / 3G, which is what Simo's flow rule accumulates
    in tension. Right to second order in the elastic strain in tension; in another state of stress the remaining
    difference is a part of the difference between the theories, which is itself about 0.2 %."""
    p = law.table_strain()
    stress = law.yield_stress(p)
    if theory == "hencky":
        stretch = 1.0 + stress / (3.0 * law.shear)
        p = np.concatenate([[0.0], np.cumsum(0.5 * (stretch[1:] + stretch[:-1]) * np.diff(p))])
        stress = stress * np.exp(-stress / (3.0 * law.bulk))
    rows = "\n".join(f"{s:.10g}, {q:.10g}" for s, q in zip(stress, p))
    return f"*MATERIAL, NAME=M\n*ELASTIC\n{law.E:.10g}, {law.nu:.10g}\n*PLASTIC\n{rows}\n"


def set_cards(kind, name, numbers):
    numbers = [str(n) for n in numbers]
    lines = [", ".join(numbers[i:i + 8]) for i in range(0, len(numbers), 8)]
    return f"*{kind}, {kind}={name}\n" + ",\n".join(lines) + "\n"


def mesh_cards(nodes, elements):
    """*NODE and *ELEMENT (C3D20R) of numpy arrays; numbers start at one."""
    text = ["*NODE, NSET=ALL"]
    text += [f"{i}, {x:.12g}, {y:.12g}, {z:.12g}" for i, (x, y, z) in enumerate(nodes, 1)]
    text.append("*ELEMENT, TYPE=C3D20R, ELSET=BODY")
    for number, row in enumerate(elements + 1, 1):
        text.append(f"{number}, " + ", ".join(map(str, row[:10])) + ",")
        text.append(", ".join(map(str, row[10:])))
    return "\n".join(text) + "\n*SOLID SECTION, ELSET=BODY, MATERIAL=M\n"


def step_cards(boundary, output, increments=1, residual=1e-5, loads=""):
    """One step: from the last step's end to these values, in `increments` equal parts that are cut if one fails."""
    part = 1.0 / increments
    return (f"*STEP, NLGEOM, INC=1000\n*STATIC\n{part:.10g}, 1., 1e-6, {part:.10g}\n"
            f"*CONTROLS, PARAMETERS=FIELD\n{residual:.3g}, 1e-2, , , , , ,\n"
            f"{boundary}{loads}{output}*END STEP\n")


def run(deck, folder, name="job"):
    """Run ccx on one thread in `folder`; returns the table of its .dat and the seconds taken. A deck that was already
    run there is not run again. Ends the program if ccx failed."""
    if shutil.which("ccx") is None:
        raise SystemExit("ccx is not installed (Debian: apt install calculix-ccx)")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    deck_file, log_file = folder / f"{name}.inp", folder / f"{name}.log"
    if deck_file.exists() and deck_file.read_text() == deck and log_file.exists() and DONE in log_file.read_text():
        return read_dat(folder / f"{name}.dat"), 0.0
    deck_file.write_text(deck)
    start = time.time()
    with open(log_file, "w") as log:
        status = subprocess.run(["ccx", "-i", name], cwd=folder, stdout=log, stderr=subprocess.STDOUT,
                                env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}).returncode
    text = log_file.read_text()
    if status != 0 or "*ERROR" in text or DONE not in text:
        raise SystemExit(f"ccx failed (status {status}); the end of its log:\n" + "\n".join(text.splitlines()[-15:]))
    return read_dat(folder / f"{name}.dat"), time.time() - start


HEADER = re.compile(r"^ *([a-z].*?) *\(.*\) *for set (\S+) and time +(\S+)")


def read_dat(path):
    """{(quantity, SET): array (steps, rows, columns)}; only the end of each step is kept."""
    blocks, rows = {}, None
    for line in open(path):
        if head := HEADER.match(line):
            rows = blocks.setdefault((head[1], head[2]), {}).setdefault(float(head[3]), [])
        elif rows is not None and line.strip():
            rows.append([float(word) for word in line.split()])
    return {key: np.array([block[t] for t in sorted(block) if abs(t - round(t)) < 1e-7])
            for key, block in blocks.items()}


# --- the plate with a hole ---

@dataclass(frozen=True)
class Plate:
    """An eighth of the plate: 0 <= x <= width/2, 0 <= y <= length/2, 0 <= z <= thickness/2, hole at the origin.
    Three blocks: A from the hole to the side, B from the hole to the line y = width/2, C the rest up to the end."""

    width: float = 20.0
    thickness: float = 8.0
    length: float = 24.0
    radius: float = 2.5
    around: int = 6      # elements along each 45 degrees of the hole
    outward: int = 6     # elements from the hole to the side
    along: int = 2       # elements from y = width/2 to the end
    through: int = 3     # elements through the half thickness
    outward_ratio: float = 5.0   # last over first element, hole to side
    through_ratio: float = 0.5   # surface over mid-plane element
    along_ratio: float = 1.0     # last (at the end) over first element

    def blocks(self):
        """For each block a map (s, t) in the unit square -> (x, y), and its numbers of elements."""
        half, radius, end = self.width / 2.0, self.radius, self.length / 2.0

        def ring(start, corner_from, corner_to):
            def place(s, t):
                angle = start + s * np.pi / 4.0
                hole = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
                edge = np.asarray(corner_from) * (1 - s[..., None]) + np.asarray(corner_to) * s[..., None]
                return hole * (1 - t[..., None]) + edge * t[..., None]
            return place

        def strip(s, t):
            return np.stack([half * (1 - s), half + (end - half) * t], -1)

        out, far = stretched(self.outward, self.outward_ratio), stretched(self.along, self.along_ratio)
        even = stretched(self.around, 1.0)
        return [(ring(0.0, (half, 0.0), (half, half)), even, out),
                (ring(np.pi / 4.0, (half, half), (0.0, half)), even, out),
                (strip, even, far)]

    def mesh(self):
        """nodes (n, 3) and C3D20 connectivity (m, 20), zero-based."""
        depth = stretched(self.through, self.through_ratio) * self.thickness / 2.0
        points, cells = [], []
        for place, s, t in self.blocks():
            cells.append(brick20(points, s, t, depth, place))
        return merge(np.concatenate(points), np.concatenate(cells))


def stretched(count, ratio):
    """2 count + 1 ends and middles of `count` intervals of [0, 1] that grow geometrically, last over first = ratio."""
    steps = np.ones(count) if count == 1 else ratio ** (np.arange(count) / (count - 1))
    corner = np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])
    values = np.empty(2 * count + 1)
    values[::2], values[1::2] = corner, 0.5 * (corner[1:] + corner[:-1])
    return values


# offsets (s, t, z) of the 20 nodes of C3D20 in half elements: corners, then the middles of the edges
C3D20 = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2],
                  [1, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0], [1, 0, 2], [2, 1, 2], [1, 2, 2], [0, 1, 2],
                  [0, 0, 1], [2, 0, 1], [2, 2, 1], [0, 2, 1]])


def brick20(points, s, t, depth, place):
    """Append a block's lattice to `points`, return its elements. `place(s, t)` gives (x, y); where (s, t) is
    left-handed, s is reversed."""
    probe = place(np.array([0.45, 0.55, 0.45]), np.array([0.45, 0.45, 0.55]))
    a, b = probe[1] - probe[0], probe[2] - probe[0]
    if a[0] * b[1] - a[1] * b[0] < 0:
        s = s[::-1]
    S, T, Z = np.meshgrid(s, t, depth, indexing="ij")
    xy = place(S, T)
    lattice = np.concatenate([xy, Z[..., None]], -1)
    first = sum(len(p) for p in points)
    points.append(lattice.reshape(-1, 3))
    number = first + np.arange(S.size).reshape(S.shape)
    i, j, k = np.meshgrid(*(np.arange(0, n - 1, 2) for n in S.shape), indexing="ij")
    i, j, k = (a.ravel()[:, None] for a in (i, j, k))
    return number[i + C3D20[:, 0], j + C3D20[:, 1], k + C3D20[:, 2]]


def merge(points, cells, digits=7):
    """One number for nodes at one place; nodes that no element uses are left out."""
    used = np.unique(cells)
    _, index, inverse = np.unique(np.round(points[used], digits) + 0.0, axis=0, return_index=True, return_inverse=True)
    renumber = np.full(len(points), -1)
    renumber[used] = inverse.ravel()
    return points[used][index], renumber[cells]


def where(condition):
    """Node numbers (from one) where the condition holds."""
    return np.flatnonzero(condition) + 1


# mean strain of the frames [%]: six elastic, twelve in the knee, then coarser
FRAMES_PERCENT = np.concatenate([[0.02, 0.04, 0.06, 0.08, 0.10, 0.12],
                                 [0.14, 0.16, 0.18, 0.20, 0.225, 0.25, 0.275, 0.30, 0.35, 0.40, 0.45, 0.50],
                                 [0.75, 1.00, 1.25, 1.50, 1.75, 2.00],
                                 2.0 + 0.3 * np.arange(1, 21)])


def plate_deck(plate, law, strains, clamped, theory="simo", largest_increment=1e-3, residual=1e-5, front=False):
    """The deck of the plate pulled to each mean strain in turn; sets END, POLE, EQUATOR (and FRONT) are printed.
    A step longer than `largest_increment` (mean strain) is divided."""
    nodes, cells = plate.mesh()
    x, y, z = nodes.T
    tiny, end, face = 1e-6, plate.length / 2.0, plate.thickness / 2.0
    sets = {"MX": where(x < tiny), "MY": where(y < tiny), "MZ": where(z < tiny), "END": where(y > end - tiny),
            "POLE": where((x < tiny) & (y < y[x < tiny].min() + tiny) & (z > face - tiny)),
            "EQUATOR": where((x < x[y < tiny].min() + tiny) & (y < tiny) & (z > face - tiny))}
    if front:
        sets["FRONT"] = where(z > face - tiny)
    deck = [mesh_cards(nodes, cells), *(set_cards("NSET", *item) for item in sets.items()),
            material_cards(law, theory), "*BOUNDARY\nMX, 1, 1\nMY, 2, 2\nMZ, 3, 3\n"]
    if clamped:
        deck.append("*BOUNDARY\nEND, 1, 1\nEND, 3, 3\n")
    output = "".join(f"*NODE PRINT, NSET={name}, FREQUENCY=1000\nU\n" for name in ("POLE", "EQUATOR"))
    output += "*NODE PRINT, NSET=END, TOTALS=ONLY, FREQUENCY=1000\nRF\n"
    if front:
        output += "*NODE PRINT, NSET=FRONT, FREQUENCY=1000\nU\n"
    for before, strain in zip([0.0, *strains], strains):
        increments = max(1, int(np.ceil((strain - before) / largest_increment - 1e-9)))
        deck.append(step_cards(f"*BOUNDARY\nEND, 2, 2, {strain * end:.12g}\n", output, increments, residual))
    return "".join(deck), nodes, cells, sets


def add_law_options(parser):
    law = Law()
    group = parser.add_argument_group("law (Eqs 18, 19)")
    group.add_argument("--E", type=float, default=law.E, help="Young's modulus [MPa] (default %(default)g)")
    group.add_argument("--nu", type=float, default=law.nu, help="Poisson's ratio (default %(default)g)")
    group.add_argument("--S_y", type=float, default=law.S_y, help="initial yield stress [MPa] (default %(default)g)")
    group.add_argument("--H", type=float, default=law.H, help="linear hardening [MPa] (default %(default)g)")
    group.add_argument("--delta", type=float, default=law.delta, help="hardening exponent (default %(default)g)")


def law_of(options):
    return Law(options.E, options.nu, options.S_y, options.H, options.delta)


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Keeps the text of the module as it is written."""


def write_table(path, header, columns, rows):
    """CSV: `#` lines first, then the names of the columns, then the rows."""
    with open(path, "w") as out:
        out.writelines(f"# {line}\n" for line in header)
        out.write(",".join(columns) + "\n")
        out.writelines(",".join(row) + "\n" for row in rows)
