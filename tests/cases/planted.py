#!/usr/bin/python3
"""Effects of the test, planted by `imic3d virtual`: found again in the record, in the images and in the fields by other means.

Usage: planted.py EXECUTABLE
"""
import csv
import json
import sys

import h5py
import numpy
import scipy.interpolate
from PIL import Image

from runs import bar, end, gmsh, require, run, workspace

PLATE = """
title: Plate with effects
specimen: {{mesh: {mesh}.msh, thickness: 4, kinematics: plane_stress, held: bottom, loaded: top}}
cameras:
  - {{name: front, pixel_size: 0.08, place: {{origin: [149.5, 164.5]}}{images}}}
material:
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {{E: 198e3, nu: 0.25, S_y: 284, H: 1480, delta: 0.042}}
simulate:
  centred: true
  value: {value}
virtual: {{size: [300, 330], noise: 0.002, depth: 16, load_noise: 5, static_frames: 2, directory: {name}, declared_mesh: coarse.msh}}
output: {name}
effects: {effects}
"""
BAR = """
title: Bar with effects
specimen: {{mesh: bar.msh, thickness: 2, {kinematics}, held: bottom, loaded: top}}
cameras:
  - {{name: front, pixel_size: 0.1, place: {{origin: [60, 170]}}}}
material: {{law: elastic, parameters: {{E: 200e3, nu: 0.3}}}}
simulate: {{clamped: false, value: [0, 0.003, 0.006]}}
virtual: {{size: [121, 341], static_frames: 1, directory: {name}, declared_mesh: declared.msh}}
output: {name}
effects: {effects}
"""
PIXEL, FRAMES = 0.08, 6
LOADING = [0, 0.008, 0.03, 0.1, 0.2]


def forces(folder):
    with open(folder / "loads.csv") as file:
        return numpy.array([float(row["force_N"]) for row in csv.DictReader(file)])


def hole_radius(image):
    """From the area of the dark disk in the middle of a reference image [mm]: specimen 0.2 of the grey levels and more, background 0.1."""
    grey = numpy.asarray(Image.open(image)).astype(float) / 65535.0
    rows, columns = numpy.mgrid[:grey.shape[0], :grey.shape[1]]
    near = numpy.hypot(columns - 149.5, rows - 164.5) * PIXEL < 4.0
    return numpy.sqrt(numpy.sum((grey < 0.15) & near) / numpy.pi) * PIXEL


def main():
    program = sys.argv[1]
    folder = workspace("planted")
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.8, size_far=2.0)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=1.0, size_far=2.5)

    def plate(name, effects="{}", status=0, value=LOADING, more=""):
        (folder / f"{name}.yaml").write_text(PLATE.format(mesh="fine", images="", name=name, effects=effects, value=value).replace("material:", more + "material:", 1))
        return run(program, "virtual", folder / f"{name}.yaml", 1, status=status, errors=status != 0)

    def correlated(name):
        """Displacement of the declared mesh that the images show [frames, nodes, 2], and its nodes."""
        (folder / f"dic_{name}.yaml").write_text(PLATE.format(mesh="coarse", images=f", images: '{name}/images/*.png', reference: 0-1", name=f"dic_{name}", effects="{}", value=LOADING))
        run(program, "dic", folder / f"dic_{name}.yaml", 1)
        with h5py.File(folder / f"dic_{name}/results.h5") as file:
            return file["dic/displacement"][:][..., :2], file["surface/nodes"][:, :2]

    plate("plain")
    plain = forces(folder / "plain")

    # Record: the same noise is drawn, so differences are exact (loads.csv has 1e-4 N).
    plate("record", "{force_zero: {force_offset: 400}}")
    require(numpy.max(numpy.abs(forces(folder / "record") - plain - 400)) < 1.5e-4, "the force zero is in every row of the record, static frames too")
    require(json.loads((folder / "record/truth.json").read_text())["effects"] == {"force_zero": {"force_offset": {"value": 400.0, "unit": "N"}}}, "truth.json says so")
    same = all((folder / f"plain/images/frame_{i:03}.png").read_bytes() == (folder / f"record/images/frame_{i:03}.png").read_bytes() for i in range(FRAMES))
    require(same, "and the images are the same")
    with h5py.File(folder / "plain/results.h5") as file:
        true = file["frames/force_predicted"][:]
    # The delay is a quarter of a frame: F(t - 0.25) between frames, before the test 0.
    plate("delay", "{delay_of_the_force: {force_delay: 0.25}}")
    before = numpy.concatenate([[0.0], true[1:-1]])
    require(numpy.max(numpy.abs(forces(folder / "delay")[2:] - plain[2:] + 0.25 * (true[1:] - before))) < 2e-4, "a delay of the force shifts it in time")
    back = [0, 0.008, 0.03, 0.025, 0.025]
    plate("back", value=back)
    plate("rubbed", "{friction: {friction_force: 150}}", value=back)
    rubbed = forces(folder / "rubbed") - forces(folder / "back")
    require(numpy.max(numpy.abs(rubbed[:2])) < 1.5e-4 and numpy.max(numpy.abs(rubbed[2:4] - 150)) < 1.0 and abs(rubbed[4] + 150) < 1.0 and abs(rubbed[5]) < 1e-3,
            f"friction adds to the recorded force on the way up, takes as much on the way back and nothing at rest ({rubbed[2:]})")
    plate("loaded", "{preload: {preload: 5000}}")
    shift = forces(folder / "loaded") - plain
    require(abs(shift[0]) < 1.5e-4 and numpy.max(numpy.abs(shift[2:] + 5000)) < 1.5e-4, "a preload is missing in the record, which is zero at the reference")

    # Camera: the difference of two correlations is a uniform growth about the image's centre.
    drift = 2e-3
    plate("drift", f"{{magnification_drift: {{magnification_drift: {drift}}}}}")
    base, nodes = correlated("plain")
    grown, _ = correlated("drift")
    for frame, clock in ((3, 0.5), (5, 1.0)):
        apart = grown[frame] - base[frame]
        at = nodes + base[frame]
        for k, axis in enumerate("xy"):
            fit, covariance = numpy.polyfit(at[:, k], apart[:, k], 1, cov=True)
            deviation = numpy.sqrt(covariance[0, 0])
            require(abs(fit[0] - drift * clock) < max(5 * deviation, 0.01 * drift) and deviation < 0.02 * drift,
                    f"frame {frame}: the images grow along {axis} by {fit[0]:.6f} +- {deviation:.6f}, planted {drift * clock:.6f}")
    bump = 2e-3
    plate("bump", f"{{camera_bump: {{step_of_magnification: {bump}, bump_onset: 0.6}}}}")
    pushed, _ = correlated("bump")
    for frame, planted in ((3, 0.0), (5, bump)):  # at half of the test and at its end
        fit = numpy.polyfit((nodes + base[frame])[:, 1], (pushed[frame] - base[frame])[:, 1], 1)
        require(abs(fit[0] - planted) < 0.02 * bump, f"frame {frame}: a camera that is pushed at 0.6 of the test has its images grown by {fit[0]:.6f}, planted {planted:.6f}")
    moved, _ = correlated("loaded")  # displacements count from the loaded state: in the plastic frames too they lack the same
    with h5py.File(folder / "plain/results.h5") as file:
        at, u, resultant = file["mesh/nodes"][:, :2], file["fields/displacement"][1, :, :2], file["frames/force_predicted"][1]
    elastic = numpy.stack([scipy.interpolate.griddata(at, u[:, k], nodes) for k in range(2)], axis=1) * 5000 / resultant
    inside = numpy.isfinite(elastic).all(axis=1)
    for frame in (3, 5):
        scale = numpy.sum((moved[frame] - base[frame])[inside] * elastic[inside]) / numpy.sum(elastic[inside]**2)
        require(abs(scale + 1) < 0.02, f"frame {frame}: a preload is missing in the displacement ({scale:.3f} of its elastic field)")

    # Light: the same noise is drawn, so that the images differ by the effect alone. The last frame's clock is 1.
    def grey(name, frame):
        return numpy.asarray(Image.open(folder / f"{name}/images/frame_{frame:03}.png")).astype(float)

    rows, columns = numpy.mgrid[:330, :300]
    x, y = (columns - 149.5) * PIXEL, (164.5 - rows) * PIXEL
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    inside = (numpy.abs(x) < high[0] - 0.5) & (numpy.abs(y) < high[1] - 0.5) & (numpy.hypot(x, y) > 3.2)
    noise, level = 0.002 * 65535, 65535.0
    plate("lamp", "{light_gain: {gain_drift: 0.05}}")
    for frame, clock in ((0, 0.0), (3, 0.5), (5, 1.0)):
        ratio = grey("lamp", frame)[inside].mean() / grey("plain", frame)[inside].mean()
        require(abs(ratio - 1 - 0.05 * clock) < 1e-4, f"frame {frame}: the light has grown by {ratio - 1:.5f}, planted {0.05 * clock}")
    # Of one camera of two.
    second = "  - {name: second, pixel_size: 0.08, place: {origin: [149.5, 164.5]}}\n"
    plate("pair", more=second)
    plate("dim", "{second_light_gain: {gain_drift: -0.05}}", more=second)
    of = lambda name, camera: numpy.asarray(Image.open(folder / f"{name}/images_{camera}/frame_005.png")).astype(float)[inside].mean()
    ratios = [of("dim", camera) / of("pair", camera) for camera in ("front", "second")]
    require(ratios[0] == 1.0 and abs(ratios[1] - 0.95) < 1e-4, f"the light of the second camera alone has faded by {1 - ratios[1]:.5f}, planted 0.05; of the first by {1 - ratios[0]:.5f}")
    require("second_light_gain" in json.loads((folder / "dim/truth.json").read_text())["effects"], "truth.json names the camera")
    plate("stray", "{light_offset: {offset_drift: 2000}}")
    more = (grey("stray", 5) - grey("plain", 5))[inside]
    require(abs(more.mean() - 2000) < 1 and more.std() < 1, f"stray light adds {more.mean():.1f} +- {more.std():.1f} grey levels, planted 2000")
    plate("side", "{light_gradient: {gradient_x: 0.004}}")
    more = (grey("side", 5) / grey("plain", 5))[inside]
    slope = numpy.polyfit(x[inside], more, 1)[0]
    require(abs(slope - 0.004) < 1e-4, f"the light grows by {slope:.5f} per mm along x, planted 0.004")
    plate("noisy", "{noise_level: {noise_drift: 0.5}}")
    more = (grey("noisy", 5) - grey("plain", 5))[inside]
    require(abs(more.std() / noise - 0.5) < 0.01 and abs(more.mean()) < 0.02 * noise, f"the noise grows by {more.std() / noise:.3f}, planted 0.5")
    plate("fine", "{aliasing: {aliased: 0.1}}")
    detail = [(grey("fine", frame) - grey("plain", frame))[inside] for frame in range(FRAMES)]
    variance = grey("plain", 0)[inside].var()
    same = [numpy.corrcoef(detail[0], one)[0, 1] for one in detail]
    require(abs(detail[0].var() / variance - 0.1) < 0.01 and abs(detail[5].var() / variance - 0.1) < 0.01, f"detail beyond the pixels has {detail[0].var() / variance:.4f} of the variance, planted 0.1")
    require(same[1] > 0.95 and same[5] < 0.9, f"its pattern in the frames goes with that in the reference by {', '.join(f'{one:.2f}' for one in same)}")
    plate("exposed", "{saturation: {saturated: 0.1}}")
    specimen = (numpy.abs(x) < high[0]) & (numpy.abs(y) < 14) & (numpy.hypot(x, y) > 2.5)
    share = numpy.mean(grey("exposed", 0)[specimen] == level)
    require(abs(share - 0.1) < 0.03 and not numpy.any(grey("plain", 0) == level), f"{share:.3f} of the pixels are saturated, planted 0.1")
    plate("flakes", "{speckle_debonding: {loose_1: 0.3, onset: 0.6}}")
    changed = [numpy.abs(grey("flakes", frame) - grey("plain", frame)) > 0.02 * level for frame in range(FRAMES)]
    place = (high - low) / (numpy.array([3, 4]) if abs(numpy.log((high - low)[0] / 3 / ((high - low)[1] / 4))) < abs(numpy.log((high - low)[0] / 2 / ((high - low)[1] / 6))) else numpy.array([2, 6]))
    area = changed[5].sum() * PIXEL**2 / numpy.prod(place)
    out = changed[5] & ((x > low[0] + place[0] + 0.5) | (y > low[1] + place[1] + 0.5))
    require(not any(changed[frame].any() for frame in range(4)) and not out.any(), "speckle comes off in its place, after its time")
    require(0.15 < area < 0.4, f"from {area:.3f} of it, planted 0.3")

    # Geometry: the hole's edge in the image. The mesh's hole is a polygon of 20 sides; pixels cut by it count by chance, 0.02 px of the radius.
    polygon = numpy.sqrt(numpy.sin(numpy.pi / 10) / (numpy.pi / 10))
    grown_by = 0.24
    plate("hole", f"{{hole_radius: {{hole_radius_error: {grown_by}}}}}")
    radius, larger = (hole_radius(folder / f"{name}/images/frame_000.png") for name in ("plain", "hole"))
    require(abs(larger - radius - polygon * grown_by) < 0.1 * PIXEL and abs(radius - polygon * 2.5) < 0.3 * PIXEL,
            f"the hole in the image has a radius of {radius:.3f} mm and with the effect {larger:.3f}, {larger - radius:.3f} more (planted {polygon * grown_by:.3f})")
    require(forces(folder / "hole")[-1] < 0.99 * plain[-1], "and carries less")

    # A bar of 30 mm of which 16, from y = -10, are declared: sizes and places are those of the declared part.
    bar(folder / "bar.msh", -15.0, 15.0, 60)
    bar(folder / "declared.msh", -10.0, 6.0, 32)

    def of_bar(name, effects, kinematics="kinematics: plane_stress"):
        (folder / f"{name}.yaml").write_text(BAR.format(name=name, effects=effects, kinematics=kinematics))
        run(program, "virtual", folder / f"{name}.yaml", 1)
        return h5py.File(folder / f"{name}/results.h5")

    slope = 0.01
    with of_bar("taper", f"{{taper: {{taper_y: {slope}}}}}") as file:
        nodes, u = file["mesh/nodes"][:], file["fields/displacement"][2, :, 1]
        force = file["frames/force_predicted"][2]
    levels = numpy.unique(nodes[:, 1].round(6))
    mean = numpy.array([u[numpy.abs(nodes[:, 1] - y) < 1e-6].mean() for y in levels])
    middle, strain = 0.5 * (levels[1:] + levels[:-1]), numpy.diff(mean) / numpy.diff(levels)
    area = 8.0 * 2.0 * (1.0 + slope * (middle + 2.0))
    inner = numpy.abs(middle) < 14.5
    worst = numpy.max(numpy.abs(strain * 200e3 * area / force - 1)[inner])
    require(worst < 2e-3, f"with a taper the strain is F/(E A(x)) within {worst:.1e}; it grows by {strain[inner].max() / strain[inner].min():.3f} along the bar")

    # Thicker by a twentieth: in plane stress all of the force, in space the mesh too.
    for name, kinematics, within in (("plane", "kinematics: plane_stress", 1e-9), ("space", "layers: 2", 2e-3)):
        depth, force = {}, {}
        for planted, effects in (("as", "{}"), ("thicker", "{thickness: {thickness_error: 0.05}}")):
            with of_bar(f"{planted}_{name}", effects, kinematics) as file:
                depth[planted], force[planted] = numpy.ptp(file["mesh/nodes"][:, 2]), file["frames/force_predicted"][2]
        require(abs(force["thicker"] / force["as"] - 1.05) < within, f"{name}: a bar that is thicker by 5 % carries {force['thicker'] / force['as']:.6f} of the force")
        require(abs(depth["thicker"] - 1.05 * depth["as"]) < 1e-9, f"and is {depth['thicker']:.3f} mm thick")

    size = 2e-4
    with of_bar("residual", f"{{residual_stress: {{residual_strain: {size}}}}}") as file:
        nodes, cells = file["mesh/nodes"][:], file["mesh/cells"][:]
        stress = file["fields/cauchy_stress"][:, :, 1]
        resultant = file["frames/force_predicted"][:]
    at = nodes[cells].mean(axis=1)
    near = numpy.abs(at[:, 1]) < 8
    expected = 200e3 * size * (1 - 3 * (at[:, 0] / 4.0) ** 2)
    worst = numpy.max(numpy.abs(stress[0] - expected)[near])
    require(worst < 0.02 * 200e3 * size, f"at rest the residual stress is parabolic across the width (within {worst:.2f} of {200e3 * size:.0f} MPa)")
    require(abs(resultant[0]) < 1e-2 * abs(resultant[1]), "without a resultant")
    worst = numpy.max(numpy.abs(stress[2] - stress[0] - 200e3 * 0.006 / 30)[near])
    require(worst < 0.3, f"and the load adds to it (within {worst:.2f} MPa)")

    share = 0.1
    with of_bar("bent", f"{{misalignment: {{bending_share: {share}}}}}", "layers: 2") as file:
        nodes, u = file["mesh/nodes"][:], file["fields/displacement"][2, :, 1]
    for name, z, factor in (("front", nodes[:, 2].max(), 1.0), ("middle", nodes[:, 2].max() - 1.0, 1 - share), ("back", nodes[:, 2].max() - 2.0, 1 - 2 * share)):
        top = (numpy.abs(nodes[:, 1] - 15) < 1e-6) & (numpy.abs(nodes[:, 2] - z) < 1e-6)
        require(numpy.max(numpy.abs(u[top] - 0.006 * factor)) < 1e-9, f"the {name} of the loaded end moves by {factor} of the front")
    slip = 0.0005
    with of_bar("slipped", f"{{grip_slip: {{slip: {slip}, slip_onset: 0.75}}}}", "layers: 2") as file:
        nodes, u = file["mesh/nodes"][:], file["fields/displacement"][:, :, 1]
    for frame, moved, slipped in ((1, 0.003, 0.0), (2, 0.006, slip)):
        for name, z, share in (("front", nodes[:, 2].max(), 0.0), ("back", nodes[:, 2].max() - 2.0, 2.0)):
            top = (numpy.abs(nodes[:, 1] - 15) < 1e-6) & (numpy.abs(nodes[:, 2] - z) < 1e-6)
            require(numpy.max(numpy.abs(u[frame][top] - moved + share * slipped)) < 1e-6, f"frame {frame}: the {name} of the loaded end has slipped by {share * slipped} mm against the front")

    # What is not understood, or would say nothing, is refused.
    for effects, words in (("{force_zer: {force_offset: 1}}", 'no effect "force_zer", near to force_zero'),
                           ("{force_zero: {offset: 1}}", 'no quantity "offset"'),
                           ("{force_zero: {force_offset: 1e6}}", "effects.force_zero.force_offset"),
                           ("{hole_radius: {hole_radius_error: 1}}", "a number from -0.5 to 0.5 [mm]"),
                           ("{hole_radius: {hole_radius_error: {free: true}}}", "no value"),
                           ("{hole_radius: {hole_radius_error: {lower: 0}}}", "neither a value nor free: true"),
                           ("{misalignment: {bending_share: 0.1}}", "lacks what it acts on"),
                           ("{grip_slip: {slip: 0.001}}", "lacks what it acts on"),
                           ("{friction: {friction_force: 100}}", "lacks what it acts on"),
                           ("{saturation: {saturated: 0.7}}", "a share up to 0.5"),
                           ("{light_gain: {gain_drift: -2}}", "effects.light_gain.gain_drift"),
                           ("{coarse_mesh: {mesh_error: 1}}", "an effect of the numerics")):
        said = plate("refused", effects, status=2)
        require(words in said, f"{effects}: {said.strip()}")
    said = run(program, "simulate", folder / "record.yaml", 1, status=2, errors=True)
    require("force_zero declared, for imic3d simulate" in said, "imic3d simulate does not ignore an effect")
    end()


main()
