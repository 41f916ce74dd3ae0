#!/usr/bin/python3
"""A uniform bar (J2, linear hardening) pulled to 18 % strain, whose stress, strain and images are closed forms: waves of random direction in
the reference, integrated over every pixel; nothing is simulated or interpolated. Identified from its images by two functionals.

Usage: uniform_bar.py EXECUTABLE
"""
import json
import pathlib
import sys
import tempfile

import h5py
import numpy
from PIL import Image

from runs import bar, end, require, run

TRUTH = {"E": 110e3, "S_y": 400.0, "H": 1200.0}
NU, HALF_WIDTH, THICKNESS, PIXEL, SIZE, STATIC = 0.32, 5.0, 1.5, 0.05, (260, 380), 3
STRAIN = numpy.array([0, 0.001, 0.002, 0.003, 0.02, 0.04, 0.06, 0.08, 0.10, 0.12, 0.14, 0.16, 0.18])  # logarithmic
CASE = """
title: Uniform bar
specimen: {{mesh: bar.msh, kinematics: plane_stress, element: quad8, thickness: {thickness}, held: bottom, loaded: top, axis: y}}
cameras:
  - {{name: front, pixel_size: {pixel}, place: {{origin: [{column}, {row}]}}, images: 'images/*.png', reference: 0-2{noise}}}
loads: {{file: loads.csv, noise: 4}}
material:
  law: j2
  hardening: linear
  parameters: {{E: 100e3, nu: {nu}, S_y: 430, H: 1000}}
identify:
  functional: {functional}
  stages:
    - {{free: [E, S_y, H], frames: "3-{last}"}}
output: {name}
"""


def response():
    """Kirchhoff stress and logarithmic strain across, at STRAIN."""
    stress = numpy.minimum(TRUTH["E"] * STRAIN, (TRUTH["S_y"] + TRUTH["H"] * STRAIN) / (1 + TRUTH["H"] / TRUTH["E"]))
    elastic = stress / TRUTH["E"]
    return stress, -NU * elastic - 0.5 * (STRAIN - elastic)


def photograph(waves, along, across):
    """Grey levels [rows, columns] of the bar with these logarithmic strains; y points up, the middle of the image stays."""
    k, phase = waves
    k = k / numpy.exp([across, along])  # [waves, 2, 1/px]: the texture is carried along
    x, y = numpy.arange(SIZE[0]) - (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2 - numpy.arange(SIZE[1])
    size = numpy.sinc(k[:, 0] / 2 / numpy.pi) * numpy.sinc(k[:, 1] / 2 / numpy.pi)  # mean over a pixel
    grey = numpy.real((numpy.exp(1j * numpy.outer(y, k[:, 1])) * (size * numpy.exp(1j * phase))) @ numpy.exp(1j * numpy.outer(k[:, 0], x)))
    grey = 128 + 40 * grey * numpy.sqrt(2 / len(phase))
    grey[:, numpy.abs(x) * PIXEL > HALF_WIDTH * numpy.exp(across)] = 20
    return grey


def main(program):
    with tempfile.TemporaryDirectory() as made:
        folder = pathlib.Path(made)
        (folder / "images").mkdir()
        random = numpy.random.default_rng(1)
        angle, number = random.uniform(0, 2 * numpy.pi, 300), random.uniform(0.5, 1.2, 300)  # waves of 5 to 13 px
        waves = number[:, None] * numpy.stack([numpy.cos(angle), numpy.sin(angle)], 1), random.uniform(0, 2 * numpy.pi, 300)
        stress, across = response()
        force = stress * numpy.exp(-STRAIN) * 2 * HALF_WIDTH * THICKNESS
        states = [0] * STATIC + list(range(1, len(STRAIN)))
        loads = ["frame,time_s,force_N"]
        for frame, state in enumerate(states):
            grey = photograph(waves, STRAIN[state], across[state]) + random.normal(size=SIZE[::-1]) * 1.5
            Image.fromarray(numpy.clip(numpy.rint(grey), 0, 255).astype(numpy.uint8)).save(folder / f"images/{frame:02}.png")
            loads.append(f"{frame},{frame},{force[state] + 4 * random.normal():.2f}")
        (folder / "loads.csv").write_text("\n".join(loads) + "\n")
        bar(folder / "bar.msh", -6.0, 6.0, 12, columns=10, half_width=HALF_WIDTH)
        found = {}
        for name, functional, noise in (("displacement_driven", "displacement_driven", ""), ("force_driven", "force_driven", ""),
                                        ("too_sure", "displacement_driven", ", noise: 0.75")):
            case = folder / f"{name}.yaml"
            case.write_text(CASE.format(name=name, noise=noise, thickness=THICKNESS, pixel=PIXEL, nu=NU, functional=functional, last=len(states) - 1,
                                        column=(SIZE[0] - 1) / 2, row=(SIZE[1] - 1) / 2))
            run(program, "identify", case)
            found[name] = json.loads((folder / name / "result.json").read_text())["parameters"]
        for name, percent in (("displacement_driven", 2.0), ("force_driven", 1.0)):
            for parameter, truth in TRUTH.items():
                off, deviation = found[name][parameter]["value"] / truth - 1, found[name][parameter]["standard_deviation"] / truth
                require(abs(off) < percent / 100, f"{name}: {parameter} {100 * off:+.2f} % off (standard deviation {100 * deviation:.2f})")
        # Half of the noise declared: the correlation leaves twice as much as that explains, which counts like noise.
        for parameter in TRUTH:
            one, other = found["displacement_driven"][parameter], found["too_sure"][parameter]
            ratio, moved = other["standard_deviation"] / one["standard_deviation"], (other["value"] - one["value"]) / one["standard_deviation"]
            require(0.8 < ratio < 1.25 and abs(moved) < 0.5, f"half of the noise declared: {parameter} moves by {moved:.2f} standard deviations, which are {ratio:.2f} times those before")
        with h5py.File(folder / "displacement_driven/results.h5") as file:
            nodes, moved = file["surface/nodes"][:], file["dic/displacement"][-1]
        expected = nodes[:, :2] * (numpy.exp([across[-1], STRAIN[-1]]) - 1)
        error = numpy.sqrt(numpy.mean((moved[:, :2] - expected) ** 2)) / PIXEL
        require(error < 0.025, f"nodes {error:.4f} px off at 18 % strain (rms)")
    end()


if __name__ == "__main__":
    main(sys.argv[1])
