#!/usr/bin/python3
"""imic3d dic with two pinhole cameras against a motion that is known: images of an analytic texture on a plane that moves,
turns and stretches, made here with the cameras' formulas and nothing of the program's."""
import csv
import json
import re
import shutil
import subprocess
import sys

import numpy

from plane_scene import BETAS, camera, focus, photograph, placement, save, turned, write_images
from runs import end, workspace

program = sys.argv[1]
folder = workspace("stereo")
flat = numpy.eye(3)[:, :2]
frames = [(flat, numpy.zeros(3))]
truth = []
for k in (1, 2):
    rotation = turned(0.4 * k, (0.6, 0.8, 0.3))
    stretch = numpy.array([[1 + 0.002 * k, 0], [0, 1 - 0.001 * k], [0, 0]])  # shear would turn the best rigid motion
    frames.append((rotation @ stretch, numpy.array([0.03, -0.02, 0.15]) * k))
    E = 0.5 * (stretch.T @ stretch - numpy.eye(2))
    truth.append((frames[-1][1], 0.4 * k * numpy.array((0.6, 0.8, 0.3)) / numpy.linalg.norm((0.6, 0.8, 0.3)), (E[0, 0], E[1, 1], E[0, 1])))
write_images(folder, frames)

nx, ny = 8, 6
nodes = [(-5.0 + 10.0 * i / nx, -4.0 + 8.0 * j / ny) for j in range(ny + 1) for i in range(nx + 1)]
cells = [(j * (nx + 1) + i + 1, j * (nx + 1) + i + 2, (j + 1) * (nx + 1) + i + 2, (j + 1) * (nx + 1) + i + 1) for j in range(ny) for i in range(nx)]
mesh = f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{len(nodes)}\n"
mesh += "".join(f"{i + 1} {x} {y} 0\n" for i, (x, y) in enumerate(nodes)) + f"$EndNodes\n$Elements\n{len(cells)}\n"
mesh += "".join(f"{i + 1} 3 2 1 1 {' '.join(map(str, cell))}\n" for i, cell in enumerate(cells)) + "$EndElements\n"
(folder / "mesh.msh").write_text(mesh)
points = placement(((-4.0, -3.0), (4.0, -3.0), (4.0, 3.0), (-4.0, 3.0)), 1)
(folder / "case.yaml").write_text(f"""title: stereo
specimen: {{mesh: mesh.msh, place: {{points: {points}}}}}
cameras:
  - {{name: left, model: pinhole, calibration: cal.xml, images: "camera_0_*.png"}}
  - {{name: right, model: pinhole, calibration: cal.xml, images: "camera_1_*.png"}}
""")
outputs = []
for ranks in (1, 2):
    run = subprocess.run(["mpirun", "--oversubscribe", "-n", str(ranks), program, "dic", "case.yaml", "--output", f"results_{ranks}"], cwd=folder, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    outputs.append(list(csv.DictReader(open(folder / f"results_{ranks}" / "motion.csv"))))
result = json.loads((folder / "results_1" / "result.json").read_text())
through = result["standard_deviation"]["out_of_plane"]["value"]
for row, (translation, rotation, strain) in zip(outputs[0], truth):
    assert row["converged"] == "1", row
    found = [numpy.array([float(row[name]) for name in names.split()]) for names in ("tx ty tz", "rx_degree ry_degree rz_degree", "E_xx E_yy E_xy")]
    print(row["frame"], "translation", found[0] - translation, "rotation", found[1] - rotation, "strain", found[2] - strain, "bending", row["bending_u_z"], "noise", through)
    assert numpy.abs(found[0][:2] - translation[:2]).max() < 2e-4  # 0.003 px
    assert abs(found[0][2] - translation[2]) < 1e-3
    assert numpy.abs(found[1] - rotation)[:2].max() < 0.02  # four deviations: 2 um of 63 nodes over 3 mm
    assert abs(found[1][2] - rotation[2]) < 0.004
    assert numpy.abs(found[2] - strain).max() < 1e-4
    assert float(row["bending_u_z"]) < 1.5 * through
for one, two in zip(*outputs):
    for name in one:
        assert abs(float(one[name]) - float(two[name])) <= 1e-6 + 1e-4 * abs(float(one[name])), (name, one[name], two[name])
for name in ("results.xdmf", "mesh_on_left.png", "residual_right_frame_0002.png", "out_of_plane_frame_0001.png", "report.html"):
    assert (folder / "results_1" / name).stat().st_size > 500, name
# The right camera is pushed by 0.4 px across the epipolar lines in the last frame: said, and no motion but half of that as a whole.
for number in (0, 1):
    shutil.copy(folder / f"camera_1_{number:02}.png", folder / f"pushed_1_{number:02}.png")
save(folder / "pushed_1_02.png", photograph(BETAS[1], *frames[-1], push=0.4))
(folder / "pushed.yaml").write_text((folder / "case.yaml").read_text().replace("camera_1_", "pushed_1_"))
run = subprocess.run([program, "dic", "pushed.yaml", "--output", "pushed"], cwd=folder, capture_output=True, text=True)
row = list(csv.DictReader(open(folder / "pushed" / "motion.csv")))[-1]
before = outputs[0][-1]
print("off epipolar", row["off_epipolar_left"], row["off_epipolar_right"], "before", before["off_epipolar_left"], before["off_epipolar_right"])
assert "in 1 of 2 frames the cameras left and right see the specimen off their epipolar lines" in run.stderr + run.stdout and "One of them was pushed, their images are not of the same moments" in run.stderr + run.stdout, run.stdout + run.stderr
assert "off their epipolar lines" in (folder / "pushed" / "report.html").read_text()
for side in ("left", "right"):
    assert abs(float(row[f"off_epipolar_{side}"]) - 0.2) < 0.01 and float(before[f"off_epipolar_{side}"]) < 0.005
strain = numpy.array([float(row[name]) - float(before[name]) for name in ("E_xx", "E_yy", "E_xy")])
print("strain changes by", strain, "residual", before["rms_right"], row["rms_right"])
assert numpy.abs(strain).max() < 1e-4 and float(row["rms_right"]) < 1.1 * float(before["rms_right"])
assert "off their epipolar" not in (folder / "results_1" / "report.html").read_text()
refused = subprocess.run([program, "identify", "case.yaml"], cwd=folder, capture_output=True, text=True)
assert refused.returncode == 2

def check(name, old, new):
    text = (folder / "case.yaml").read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new))
    done = subprocess.run([program, "check", name], cwd=folder, capture_output=True, text=True)
    return done.stdout + done.stderr


assert "specimen.place.points" not in (said := check("right.yaml", "title: stereo", "title: right")) and "contrast on the mesh" not in said, said
assert "specimen.place.points: once" in (said := check("other_camera.yaml", "specimen: {mesh: mesh.msh, place: {", "specimen: {mesh: mesh.msh, place: {camera: right, deviation: 0.1, ")), said
(folder / "other.xml").write_text((folder / "cal.xml").read_text().replace("180 10.0 0 ", "180 10.0 0.6 "))
assert "of their contrast on the mesh" in (said := check("other.yaml", "calibration: cal.xml", "calibration: other.xml")), said
# Along a flat specimen the points alone hold the mesh: its outline tells where they are off.
for number, beta in enumerate(BETAS):
    for frame, motion in enumerate(frames):
        save(folder / f"ends_{number}_{frame:02}.png", photograph(beta, *motion, half=(5.0, 4.0)))
ends = (folder / "case.yaml").read_text().replace("camera_", "ends_")
assert str(points) in ends
for name, off in (("ends", 0.0), ("ends_off", 6.0)):
    (folder / "case_of_ends.yaml").write_text(ends.replace(str(points), str([[x, y, column + off, row] for x, y, column, row in points])))
    done = subprocess.run([program, "check", "case_of_ends.yaml"], cwd=folder, capture_output=True, text=True)
    said = re.search(r"specimen\.place: the outline in the reference of camera left lies up to ([.\d]+) px beside the mesh's, in the mean by \((\S+), (\S+)\) px", done.stdout + done.stderr)
    print(name, said and said.groups())
    assert done.returncode == 0 and (said is None if off == 0 else abs(float(said[2]) + off) < 0.7 and abs(float(said[3])) < 0.7), done.stdout + done.stderr
# Of several frames, whose steps differ, it is told whether one camera is pushed or late.
series = [(flat, numpy.array([0.0, -0.006 * k * k, 0.01 * k])) for k in range(6)]
for k, motion in enumerate(series):
    save(folder / f"row_0_{k:02}.png", photograph(BETAS[0], *motion))
    save(folder / f"push_1_{k:02}.png", photograph(BETAS[1], *motion, push=0.4 * (k > 2)))
    save(folder / f"late_1_{k:02}.png", photograph(BETAS[1], *series[max(0, k - 1)]))
for name, told in (("push", "It is alike in all of them, as if one of them was pushed."), ("late", "It is as if the images of right were about 1 frames behind those of the others.")):
    (folder / f"row_{name}.yaml").write_text((folder / "case.yaml").read_text().replace("camera_0_", "row_0_").replace("camera_1_", f"{name}_1_"))
    run = subprocess.run([program, "dic", f"row_{name}.yaml", "--output", f"row_{name}"], cwd=folder, capture_output=True, text=True)
    print([line for line in (run.stdout + run.stderr).splitlines() if "epipolar" in line])
    assert told in run.stdout + run.stderr, run.stdout + run.stderr

# The usual mistakes are told by what makes the references agree.
in_metres = (folder / "cal.xml").read_text()
for beta in BETAS:
    t = camera(beta)[1]
    in_metres = in_metres.replace(f"{t[0]} {t[1]} {t[2]}</o", f"{t[0] / 1e3} {t[1] / 1e3} {t[2] / 1e3}</o")
(folder / "metres.xml").write_text(in_metres)
assert in_metres != (folder / "cal.xml").read_text()
half = (folder / "cal.xml").read_text().replace('id="1">100 85 1500.0 1500.0', 'id="1">50 42.5 750.0 750.0')
assert half != (folder / "cal.xml").read_text()
(folder / "half.xml").write_text(half)
(folder / "corner.xml").write_text((folder / "cal.xml").read_text().replace('id="1">100 85', 'id="1">20 85'))
(R0, t0), (R1, t1) = (camera(beta) for beta in BETAS)
R, T = R1 @ R0.T, t1 - R1 @ R0.T @ t0
matrix = lambda name, values: f"{name}: !!opencv-matrix\n  rows: {len(values)}\n  cols: {len(values[0])}\n  dt: d\n  data: [{', '.join(f'{float(x)!r}' for row in values for x in row)}]\n"
lenses = lambda lengths: "".join(matrix(f"M{c}", [[f, 0, 100], [0, f, 85], [0, 0, 1]]) + matrix(f"D{c}", [[0, 0, 0, 0, 0]]) for c, f in enumerate(lengths, 1))
lens = lenses((focus, focus))
wide = 0.8 * focus  # of the right camera
(folder / "lenses.yml").write_text("%YAML:1.0\n---\n" + lenses((wide, focus)) + matrix("R", R) + matrix("T", T[:, None]))
for number, motion in enumerate(frames):
    save(folder / f"wide_1_{number:02}.png", photograph(BETAS[1], *motion, focus=wide))
(folder / "opencv.yml").write_text("%YAML:1.0\n---\n" + lens + matrix("R", R) + matrix("T", T[:, None]))
(folder / "transposed.yml").write_text("%YAML:1.0\n---\n" + lens + matrix("R", R.T) + matrix("T", T[:, None]))
(folder / "vector.yml").write_text("%YAML:1.0\n---\n" + lens + matrix("R", T[:, None]) + matrix("T", T[:, None]))
(folder / "millimetres.xml").write_text((folder / "cal.xml").read_text().replace("100 85 1500.0 1500.0", "0.5 0.4 7.5 7.5"))
(folder / "inverse.yml").write_text("%YAML:1.0\n---\n" + lens + matrix("R", R.T) + matrix("T", -(R.T @ T)[:, None]))
for name, old, new, told in (("exchanged.yaml", "calibration: cal.xml", "calibration: cal.xml, index: {}", "with left and right exchanged in the calibration they agree"),
                             ("twice.yaml", "calibration: cal.xml", "calibration: cal.xml, index: 0", "cameras.right.calibration: the same place as that of left; allowed: another camera of the calibration (index)"),
                             ("corner.yaml", "cal.xml", "corner.xml", "cameras.right: the principal point of the calibration, (20, 85), lies far from the middle of images of 200 x 170 px"),
                             ("inverse.yaml", "cal.xml", "inverse.yml", "with rotations and translations the other way round"),
                             ("transposed.yaml", "cal.xml", "transposed.yml", "with the rotations transposed, the translations as they are, they agree"),
                             ("vector.yaml", "cal.xml", "vector.yml", "R: 3 x 1 numbers; allowed: 3 x 3 numbers, which cv::Rodrigues makes of a rotation vector"),
                             ("millimetres.yaml", "cal.xml", "millimetres.xml", "cameras.left: a focal length of 7.5 px, where the images are 200 px wide: are focal length and principal point in millimetres?"),
                             ("pictures.yaml", "camera_1_", "camera_0_", "cameras.right.images: the same reference as that of left; allowed: images of another camera"),
                             ("metres.yaml", "cal.xml", "metres.xml", "with the lengths of the calibration times 1000 they agree"),
                             ("half.yaml", "cal.xml", "half.xml", "with a calibration of right for images 2 times as large they agree"),
                             ("lenses.yaml", "cal.xml", "lenses.yml", "with the lenses of left and right exchanged in the calibration, their places as they are, they agree"),
                             ("images.yaml", "", "", "with the images of left and right exchanged they agree")):
    text = (folder / "case.yaml").read_text()
    if name == "exchanged.yaml":
        text = text.replace(old, new.format(1), 1).replace(old + ', images: "camera_1', new.format(0) + ', images: "camera_1')
    elif name == "lenses.yaml":
        text = text.replace(old, new).replace("camera_1_", "wide_1_")
    elif name == "images.yaml":
        text = text.replace("camera_0_", "camera_x_").replace("camera_1_", "camera_0_").replace("camera_x_", "camera_1_")
    else:
        text = text.replace(old, new)
    (folder / name).write_text(text)
    done = subprocess.run([program, "check", name], cwd=folder, capture_output=True, text=True)
    print(name, [line for line in (done.stdout + done.stderr).splitlines() if "agree" in line or "the same" in line])
    assert told in done.stdout + done.stderr, done.stdout + done.stderr
(folder / "opencv.yaml").write_text((folder / "case.yaml").read_text().replace("cal.xml", "opencv.yml"))
done = subprocess.run([program, "check", "opencv.yaml"], cwd=folder, capture_output=True, text=True)
assert done.returncode == 0 and not any(word in done.stdout + done.stderr for word in ("agree", "the same", "contrast", "principal")), done.stdout + done.stderr
print("passed")
end()
