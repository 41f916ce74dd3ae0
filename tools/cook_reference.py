#!/usr/bin/env python3
"""Plastic Cook's membrane by a small program of its own, in the theory of imic3d: log strain, exponential map, yield
function in Kirchhoff stress (or, with --yield-in cauchy, in Cauchy stress as CalculiX has it).

n x n quadrilaterals with eight nodes and four integration points, plane strain, total Lagrangian; the tangent is by
differences of the first Piola-Kirchhoff stress. It shares no line with imic3d and only the law with calculix_cook.py,
so that the converged displacement of the corner is known in both theories.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

import calculix as cx

sys.path.insert(0, str(Path(__file__).resolve().parent / "meshes"))
import cook  # noqa: E402  (a script in a folder, not a package)

NODES = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, -1], [1, 0], [0, 1], [-1, 0.0]])
FLAT_3D = np.array([0, 1, 3, 4])  # the four in-plane components of a 3 x 3


def gradients(xi, eta):
    """Derivatives (2, 8) of the serendipity functions."""
    result = np.empty((2, 8))
    for a, (p, q) in enumerate(NODES):
        if a < 4:
            result[:, a] = [p * (1 + q * eta) * (2 * p * xi + q * eta) / 4,
                            q * (1 + p * xi) * (2 * q * eta + p * xi) / 4]
        elif p == 0:
            result[:, a] = [-xi * (1 + q * eta), q * (1 - xi**2) / 2]
        else:
            result[:, a] = [p * (1 - eta**2) / 2, -eta * (1 + p * xi)]
    return result


def return_mapping(law, F, Cp_inverse, p, in_cauchy):
    """Return mapping for many points: F, Cp_inverse (n, 3, 3), p (n). Returns P, the new Cp^-1 and the new p."""
    values, vectors = np.linalg.eigh(F @ Cp_inverse @ F.transpose(0, 2, 1))
    strain = 0.5 * np.log(values)
    volume = strain.sum(1, keepdims=True)
    dev = strain - volume / 3.0
    trial = 2.0 * law.shear * np.sqrt(1.5) * np.linalg.norm(dev, axis=1)
    scale = np.exp(volume[:, 0]) if in_cauchy else np.ones(len(p))
    step = np.zeros(len(p))
    on = trial > scale * law.yield_stress(p)
    for _ in range(60):  # Newton from the left on a convex decreasing function: monotone
        residual = trial - 3.0 * law.shear * step - scale * law.yield_stress(p + step)
        slope = 3.0 * law.shear + scale * law.slope(p + step)
        step = np.where(on, step + residual / slope, 0.0)
        if np.max(np.abs(residual[on]), initial=0.0) < 1e-14 * law.E:
            break
    dev = dev * (1.0 - 3.0 * law.shear * step / np.where(on, trial, 1.0))[:, None]
    tau = np.einsum("nia,na,nja->nij", vectors, 2.0 * law.shear * dev + law.bulk * volume, vectors)
    be = np.einsum("nia,na,nja->nij", vectors, np.exp(2.0 * (dev + volume / 3.0)), vectors)
    inverse = np.linalg.inv(F)
    return tau @ inverse.transpose(0, 2, 1), inverse @ be @ inverse.transpose(0, 2, 1), p + step


class Membrane:
    """n x n elements; unknowns 2 per node."""

    def __init__(self, n):
        grid = np.linspace(0.0, 1.0, 2 * n + 1)
        T, S = np.meshgrid(grid, grid, indexing="ij")
        number = np.arange(S.size).reshape(S.shape)
        j, i = (2 * a.ravel()[:, None] for a in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        offset = (NODES + 1).astype(int)
        cells = number[j + offset[:, 1], i + offset[:, 0]]
        used, inverse = np.unique(cells, return_inverse=True)
        self.cells = inverse.reshape(cells.shape)
        self.nodes = cook.place(S, T).reshape(-1, 2)[used]
        g = np.sqrt(1.0 / 3.0)
        self.B, self.weight = [], []
        for point in ((-g, -g), (g, -g), (g, g), (-g, g)):
            d = gradients(*point)
            J = np.einsum("ia,eak->eki", d, self.nodes[self.cells])
            self.B.append(np.einsum("eij,ia->eja", np.linalg.inv(J), d))
            self.weight.append(np.linalg.det(J))
        self.B, self.weight = np.array(self.B), np.array(self.weight)  # (4, m, 2, 8), (4, m)
        assert self.weight.min() > 0
        self.dofs = (2 * self.cells[:, :, None] + np.arange(2)).reshape(len(cells), 16)
        x, y = self.nodes.T
        left, right = np.flatnonzero(x < 1e-9), np.flatnonzero(x > 48 - 1e-9)
        self.free = np.setdiff1d(np.arange(2 * len(x)), np.concatenate([2 * left, 2 * left + 1]))
        self.load = np.zeros(2 * len(x))  # unit total, upwards: Simpson's rule along each edge
        right = right[np.argsort(y[right])]
        for a, m, b in zip(right[0:-2:2], right[1:-1:2], right[2::2]):
            self.load[[2 * a + 1, 2 * m + 1, 2 * b + 1]] += np.array([1, 4, 1]) / (6.0 * n)
        self.corner = 2 * right[-1] + 1

    def gradient(self, u):
        """F (4 m, 3, 3)."""
        H = np.einsum("gejA,eAi->geij", self.B, u.reshape(-1, 2)[self.cells]).reshape(-1, 2, 2)
        F = np.tile(np.eye(3), (len(H), 1, 1))
        F[:, :2, :2] += H
        return F

    def assemble(self, u, stress):
        """Internal force and tangent; `stress(F)` gives P (4 m, 3, 3)."""
        F = self.gradient(u)
        P = stress(F).reshape(-1, 9)[:, FLAT_3D]
        A = np.empty((len(F), 4, 4))
        for k, component in enumerate(FLAT_3D):
            shifted = F.copy()
            shifted.reshape(-1, 9)[:, component] += 1e-7
            forward = stress(shifted).reshape(-1, 9)[:, FLAT_3D]
            shifted.reshape(-1, 9)[:, component] -= 2e-7
            A[:, :, k] = (forward - stress(shifted).reshape(-1, 9)[:, FLAT_3D]) / 2e-7
        m = len(self.cells)
        A, P = A.reshape(4, m, 2, 2, 2, 2), P.reshape(4, m, 2, 2)
        inner = np.einsum("ge,geij,geja->eai", self.weight, P, self.B).reshape(m, 16)
        K = np.einsum("ge,geijkl,geja,gelb->eaibk", self.weight, A, self.B, self.B, optimize=True).reshape(m, 16, 16)
        force = np.bincount(self.dofs.ravel(), inner.ravel(), len(u))
        rows, columns = np.repeat(self.dofs, 16, axis=1).ravel(), np.tile(self.dofs, (1, 16)).ravel()
        return force, coo_matrix((K.ravel(), (rows, columns)), shape=(len(u), len(u))).tocsc()


def solve(law, n, total, increments, in_cauchy):
    """Vertical displacement of the corner at full load."""
    membrane = Membrane(n)
    u = np.zeros(2 * len(membrane.nodes))
    Cp, p = np.tile(np.eye(3), (4 * n * n, 1, 1)), np.zeros(4 * n * n)
    free, previous = membrane.free, np.zeros_like(u)
    for step in range(1, increments + 1):
        outer = membrane.load * total * step / increments
        start, u = u, u + (previous if step > 1 else 0.0)
        for iteration in range(25):
            force, K = membrane.assemble(u, lambda F: return_mapping(law, F, Cp, p, in_cauchy)[0])
            residual = (outer - force)[free]
            if np.linalg.norm(residual) < 1e-9 * np.linalg.norm(outer):
                break
            u = u.copy()
            u[free] += splu(K[free][:, free]).solve(residual)
        else:
            raise SystemExit(f"no equilibrium in increment {step}")
        previous = u - start
        _, Cp, p = return_mapping(law, membrane.gradient(u), Cp, p, in_cauchy)
    return u[membrane.corner], p.max()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=cx.HelpFormatter)
    parser.add_argument("--n", type=int, nargs="+", default=[8, 16, 32], help="elements along a side (default 8 16 32)")
    parser.add_argument("--increments", type=int, default=40, help="of the load (default %(default)d)")
    parser.add_argument("--tau", type=float, default=0.3125, help="shear traction [kN/mm^2] (default %(default)g)")
    parser.add_argument("--yield-in", choices=("kirchhoff", "cauchy"), default="kirchhoff",
                        help="stress that is compared with sigma_y (default %(default)s)")
    options = parser.parse_args()
    total, in_cauchy = 16.0 * options.tau, options.yield_in == "cauchy"
    for n in options.n:
        top, plastic = solve(cx.SaturationLaw(), n, total, options.increments, in_cauchy)
        print(f"n = {n}, {options.increments} increments, yield in {options.yield_in} stress: {top:.4f} mm "
              f"(largest plastic strain {plastic:.3f})", flush=True)


if __name__ == "__main__":
    main()
