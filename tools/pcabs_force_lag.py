#!/usr/bin/env python3
"""Does the force of pcabs_tension lag behind its images?  tools/pcabs_force_lag.py runs/pcabs_tension/results.h5

Image 278 shows the specimen broken, with the pieces apart, while the record still reads 972 N and falls by the same
factor from row to row: a first-order low-pass. Its time constant comes from these rows alone; the strain of the waist
(global DIC, plane fitted to its nodes) then shows, as an independent check, whether stress against strain starts at zero.
IMIC3D_DATA: the data folder (default ../shared/data from the project's root)."""
import csv
import os
import pathlib
import sys

import h5py
import numpy as np

SECTION = 12.0 * 3.2  # mm^2
root = pathlib.Path(__file__).resolve().parent.parent
data = pathlib.Path(os.environ.get("IMIC3D_DATA", root / "../shared/data"))
rows = list(csv.DictReader(open(data / "pcabs_tension/frames.csv")))
time = np.array([float(row["time_s"]) for row in rows])
force = 1e3 * np.array([float(row["force_kN"]) for row in rows])

offset = force[:3].mean()
force -= offset
after = slice(278, 281)
constants = -np.diff(time[after]) / np.diff(np.log(force[after]))
lag = constants.mean()
print(f"offset {offset:.2f} N; time constant from rows 278-280: {', '.join(f'{1e3 * c:.2f}' for c in constants)} ms")

corrected = force + lag * np.gradient(force, time)
with h5py.File(sys.argv[1]) as results:
    numbers = results["frames/number"][:].astype(int)
    nodes = results["surface/nodes"][:]
    displacement = results["dic/displacement"][:]
waist = np.abs(nodes[:, 0]) < 6.01
plane = np.c_[np.ones(waist.sum()), nodes[waist, :2]]
used = [k for k, n in enumerate(numbers) if 8 <= n <= 22]
strain = np.array([np.linalg.lstsq(plane, displacement[k][waist, 0], rcond=None)[0][1] for k in used])
print("frames 8-22           E of the chord [MPa]  strain at zero stress  rms about a line through zero [N]")
for name, series in (("as recorded", force), ("lag undone", corrected)):
    stress = series[numbers[used]] / SECTION
    slope, level = np.polyfit(strain, stress, 1)
    through = stress @ strain / (strain @ strain)
    print(f"  {name:12} {slope:18.0f} {-1e3 * level / slope:20.2f}e-3 {SECTION * np.sqrt(np.mean((stress - through * strain) ** 2)):20.1f}")
delays = np.arange(0.0, 0.1201, 0.005)
misfit = []
for delay in delays:
    stress = np.interp(time[numbers[used]] + delay, time, force)
    misfit.append(np.sqrt(np.mean((strain - stress * (stress @ strain) / (stress @ stress)) ** 2)))
print(f"plain delay that makes strain and force proportional best: {1e3 * delays[int(np.argmin(misfit))]:.0f} ms "
      f"(rms strain {1e3 * min(misfit):.3f}e-3, without delay {1e3 * misfit[0]:.3f}e-3)")
