#!/usr/bin/python3
"""One identification on 1, 2, 3 and 5 ranks in 1, 2, 3 and 7 groups of ranks (--few: three of these): uneven groups, groups without a task, more groups than ranks.

Usage: groups.py EXECUTABLE [--few]
The parameters agree to 1e-9: the split over ranks changes the order of sums only, which costs about 1e-15 of the equilibrium; Newton's method ends each
frame, and Gauss-Newton the stage, far below their tolerances, and differences over perturbations of 1e-3 keep 12 digits.
"""
import json
import sys

import restart_case
from runs import end, require, run, workspace

RUNS = {1: ("1", "7"), 2: ("1", "2", "auto"), 3: ("1", "2", "3", "7"), 5: ("2", "3", "7", "auto")}
FEW = {1: ("7",), 2: ("auto",), 3: ("2",)}


def main():
    program = sys.argv[1]
    folder = workspace("groups")
    restart_case.make(program, folder)
    truth = None
    for ranks, splits in (FEW if "--few" in sys.argv else RUNS).items():
        for groups in splits:
            case = restart_case.case(folder, f"on_{ranks}_in_{groups}", variant="perturbed", more=f"  groups: {groups}\n", dic_groups=groups)
            said = run(program, "check", case, ranks)
            run(program, "identify", case, ranks)
            out = folder / case.stem
            truth = truth or restart_case.parameters(out)
            apart, deviations = restart_case.difference(out, truth)
            measured = json.loads((out / "result.json").read_text())["groups"]
            made = {what: [group["ranks"] for group in of] for what, of in measured.items()}
            as_asked = groups == "auto" or all(len(of) == min(int(groups), ranks) for of in made.values())
            require(apart < 1e-9 and deviations < 1e-6 and as_asked and set(made) == {"correlation", "simulations"} and all(sum(of) == ranks for of in made.values()),
                    f"{ranks} ranks, groups: {groups}: parameters {apart:.1e}, deviations {deviations:.1e}, groups of {made}")
            for what, plan in (("correlation", "frames"), ("simulations", "simulations")):
                lines = [line for line in said.splitlines() if line.startswith(f"  {plan} ")]
                require(len(lines) == 1 and f" of {', '.join(map(str, made[what]))} rank" in lines[0], f"the plan of imic3d check is what was done: {lines}")
            for what, of in measured.items():
                whole = [group["busy"]["value"] + group["idle"]["value"] for group in of]
                require(min(whole) > 0.0 and max(whole) - min(whole) < 0.1 * max(whole) + 0.05, f"{what}: busy and idle make the same time in every group {[round(x, 3) for x in whole]}")
    end()


main()
