#!/usr/bin/python3
"""Displacements of the identified model, of DIC and of the truth on the surface nodes: which of the first two is nearer to the third.
Plane stress, one telecentric camera.

Usage: nodal_gap.py RESULTS VIRTUAL STATIC PIXEL     folders of an identification and of its virtual test, frames at rest, pixel size

Prints the root mean square over frames of each difference, in pixels, in the norm of a white texture (integral of bilinear pieces over
the surface); the model without its rigid motion, which the images settle.
"""
import sys

import h5py
import numpy
import scipy.sparse
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, cKDTree


def mass(nodes, quads):
    """Integrals of the bilinear shape functions' products [nodes x nodes]."""
    rows, columns, values, g = [], [], [], 1 / numpy.sqrt(3)
    for quad in quads:
        for a, b in ((-g, -g), (g, -g), (g, g), (-g, g)):
            N = 0.25 * numpy.array([(1 - a) * (1 - b), (1 + a) * (1 - b), (1 + a) * (1 + b), (1 - a) * (1 + b)])
            slopes = 0.25 * numpy.array([[b - 1, a - 1], [1 - b, -1 - a], [1 + b, 1 + a], [-1 - b, 1 - a]])
            rows += list(numpy.repeat(quad, 4))
            columns += list(numpy.tile(quad, 4))
            values += list((numpy.outer(N, N) * abs(numpy.linalg.det(nodes[quad].T @ slopes))).ravel())
    return scipy.sparse.csr_matrix((values, (rows, columns)), shape=(len(nodes),) * 2)


def on_the_surface(surface, nodes, cells, u):
    """Nodal values [frames x nodes x 2] at the surface's nodes: the mesh's own, and the middles of its quadratic elements."""
    distance, nearest = cKDTree(nodes).query(surface)
    values = u[:, nearest]
    middles = numpy.flatnonzero(distance > 1e-9)
    if len(middles):
        serendipity = numpy.array([-0.25] * 4 + [0.5] * 4)
        owner = cKDTree(numpy.einsum("i,cij->cj", serendipity, nodes[cells])).query(surface[middles])[1]
        values[:, middles] = numpy.einsum("i,tcij->tcj", serendipity, u[:, cells[owner]])
    return values


def main():
    folder, virtual, static, pixel = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    with h5py.File(folder + "/results.h5") as file:
        surface, quads = file["surface/nodes"][:, :2], file["surface/cells"][:]
        dic = file["dic/displacement"][:, :, :2]
        model = on_the_surface(surface, file["mesh/nodes"][:, :2], file["mesh/cells"][:], file["fields/displacement"][:, :, :2])
    with h5py.File(virtual + "/results.h5") as file:
        made, path = Delaunay(file["mesh/nodes"][:, :2]), file["fields/displacement"][:, :, :2]
    M = mass(surface, quads)
    inner = lambda u, v: sum(u[:, k] @ (M @ v[:, k]) for k in (0, 1))

    def without_rigid_motion(u, at):
        modes = [numpy.stack(mode, 1) for mode in ((numpy.ones(len(at)), numpy.zeros(len(at))), (numpy.zeros(len(at)), numpy.ones(len(at))), (-at[:, 1], at[:, 0]))]
        size = numpy.linalg.solve([[inner(a, b) for b in modes] for a in modes], [inner(a, u) for a in modes])
        return u - sum(a * mode for a, mode in zip(size, modes))

    squares = []
    for frame in range(static, len(dic)):
        step = frame - static + 1
        if step >= len(path) or not numpy.isfinite(dic[frame]).all():
            continue
        truth = LinearNDInterpolator(made, path[step])(surface)
        outside = numpy.isnan(truth).any(axis=1)  # the hole is a polygon on either mesh
        truth[outside] = path[step][cKDTree(made.points).query(surface[outside])[1]]
        at = surface + truth
        squares.append([inner(u, u) for u in (without_rigid_motion(model[frame] - dic[frame], at), dic[frame] - truth,
                                              without_rigid_motion(model[frame] - truth, at))])
    rms = numpy.sqrt(numpy.mean(squares, axis=0) / M.sum()) / pixel
    print(f"{folder}: model - DIC {rms[0]:.4f} px, DIC - truth {rms[1]:.4f} px, model - truth {rms[2]:.4f} px ({len(squares)} frames)")


main()
