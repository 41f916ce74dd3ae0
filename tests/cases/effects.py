#!/usr/bin/python3
"""Effects of the material on a plate with a hole, in 3D and in plane stress: declared in the case file, solved, and seen in the force.

Usage: effects.py EXECUTABLE
"""
import math
import pathlib
import subprocess
import sys
import tempfile

from runs import end, gmsh, require, run

CASE = """
title: Plate with a hole
specimen: {{mesh: plate.msh, {kinematics}, thickness: 4, held: bottom, loaded: top}}
material:
  hardening: linear
  effects: [{effects}]
  parameters: {{E: 198e3, nu: 0.25, S_y: 284, H: 1480{parameters}}}
simulate:
  centred: true
  steps_per_frame: 16
  time: [{time}]
  value: [0, 0.05, 0.2, 0.3, 0.1, -0.1]
output: out
"""

UNITS = """
title: A bar
units: {{length: {length}, force: {force}, time: s}}
material: {{hardening: linear, parameters: {{E: 200e3, nu: 0.3, S_y: 200, H: 100}}}}
experiments: [{{name: bars, file: bar.csv, strain: strain, stress: stress}}]
output: out
"""
EFFECTS = ["kinematic", "hill", "viscosity", "rate", "heating", "voce_term", "voce_term_2", "power_term", "plateau", "damage", "pressure"]


def main():
    program = sys.argv[1]
    listed = subprocess.run([program, "effects"], capture_output=True, text=True, check=True).stdout.split("\n")
    for name in EFFECTS:
        at = [i for i, line in enumerate(listed) if line.startswith(f"{name} (material")]
        require(len(at) == 1 and " null " in listed[at[0] + 1] and "confused with" in "".join(listed[at[0]:at[0] + 9]), f"imic3d effects lists {name} with its null values")
    for quantity, unit in (("compliance", "length^2/force"), ("heating", "length^2/force"), ("C_1", "force/length^2"), ("eta", "force/length^2 time^m"), ("taper_x", "1/length")):
        require(any(line.split()[:1] == [quantity] and f"[{unit}]" in line for line in listed), f"{quantity} has the unit {unit}")
    for name, null in (("thickness (geometry", "null 0 "), ("Poisson's ratio (material", "null as declared"), ("gain (record", "null 1 ")):
        at = [i for i, line in enumerate(listed) if line.startswith(name)]
        require(len(at) == 1 and null in listed[at[0] + 1] and "confused with" in listed[at[0] + 2], f"imic3d effects lists {name}, …): {null}")
    require(sum("groups of stress-strain curves: " in line for line in listed) == 6 and any("strain_gain_of_GROUP" in line for line in listed), "and what a group of curves can have for itself")
    functions = sum("one formula for the hardening curve" in line for line in listed), sum("one formula for the dependence on the rate" in line for line in listed)
    require(functions == (4, 2), f"four formulas for the hardening curve, two for the dependence on the rate {functions}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        (folder / "bar.csv").write_text("strain,stress\n0,0\n0.001,100\n0.002,150\n")
        for length, force, unit in (("mm", "N", "1/MPa"), ("um", "kN", "um^2/kN")):
            (folder / "units.yaml").write_text(UNITS.format(length=length, force=force))
            listed = run(program, "effects", folder / "units.yaml", 1).splitlines()
            require(any(line.split()[:1] == ["heating"] and f"[{unit}]" in line for line in listed), f"in {force} and {length} the inverse of a stress is {unit}")
        gmsh("plate_with_hole", folder / "plate.msh", length=24, size_hole=2.5, size_far=5)

        def forces(kinematics, effects="", parameters="", times=(0, 1, 2, 3, 4, 5), ranks=1):
            (folder / "case.yaml").write_text(CASE.format(kinematics=kinematics, effects=effects, parameters=parameters, time=", ".join(map(str, times))))
            lines = run(program, "simulate", folder / "case.yaml", ranks).splitlines()
            return [float(line.split()[2]) for line in lines if len(line.split()) == 3 and line.split()[0].isdigit()]

        for kinematics in ("kinematics: plane_stress", "layers: 1, mid_plane_symmetry: true"):
            base = forces(kinematics)
            require(len(base) == 5, f"{kinematics}: every frame converged")
            null = forces(kinematics, ", ".join(EFFECTS))
            worst = max(abs(a / b - 1) for a, b in zip(null, base))
            require(worst < 1e-5, f"with effects at their null values and the unsymmetric solver the forces are the same ({worst:.0e})")
            kinematic = forces(kinematics, "kinematic", ", C_1: 20e3, gamma_1: 100", ranks=2)
            require(kinematic[2] > 1.2 * base[2], f"a back-stress adds to the force ({kinematic[2] / base[2]:.3f})")
            require(abs(kinematic[4]) < abs(kinematic[2]) - 0.5 * (abs(base[2]) - abs(base[4])), "and yields earlier on reversal")
            C, rate_0 = 0.05, 1e-8
            fast = forces(kinematics, "rate", f", C_rate: {C}, rate_0: {rate_0}", [0, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3])
            slow = forces(kinematics, "rate", f", C_rate: {C}, rate_0: {rate_0}")
            # Local rates are far above rate_0: the flow stress grows by C ln 1000 of its quasi-static value everywhere.
            expected = C * math.log(1000) * base[2]
            require(abs((fast[2] - slow[2]) / expected - 1) < 0.05, f"1000 times faster the force is higher by {fast[2] - slow[2]:.0f} N, expected {expected:.0f} N")
    end()


main()
