"""Trials of `imic3d loop` with known truth: running them, judging their verdicts, the table."""

import csv
import hashlib
import json
import math
import os
import pathlib
import subprocess
import sys

import numpy as np


class Suite:
    """`make(folder, planted, seed)` writes a case file; `truth`: true values of the declared parameters."""

    def __init__(self, folder, program, make, truth):
        self.folder, self.program, self.make, self.truth, self.rows, self.invisible, self.formula_for = folder, os.path.abspath(program), make, truth, [], set(), {}
        self.off = []  # of each test without any effect: parameter -> relative error, error in standard deviations
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        folder.mkdir(parents=True, exist_ok=True)
        self.digest = hashlib.sha256(pathlib.Path(self.program).read_bytes()).hexdigest()

    def run(self, folder, planted, seed):
        """result.json of a trial, None if the program failed, "refused" if it took the data for a mistake. What the same program ran is not run again."""
        done, what = folder / "run/result.json", folder / "planted.json"
        text = json.dumps({"planted": planted, "seed": seed, "program": self.digest}, sort_keys=True)
        if not (done.exists() and what.exists() and what.read_text() == text):
            self.make(folder, planted, seed)
            with open(folder / "log.txt", "w") as log:
                status = subprocess.run([self.program, "loop", "case.yaml"], cwd=folder, stdout=log, stderr=subprocess.STDOUT).returncode
            if status != 0:
                return "refused" if status == 2 else None
            what.write_text(text)
        return json.loads(done.read_text())

    def trial(self, kind, effect, multiple, planted, seed, parameter=None):
        """kind: null, effect, pair (`a + b`), outside, fault, without (the effect, which is not among the candidates); `parameter`: of the size in the result, compared with what was planted first."""
        result = self.run(self.folder / f"{kind}_{effect}_{multiple}_{seed}".replace(" ", "_").replace("'", ""), planted, seed)
        nan = math.nan
        row = dict(kind=kind, effect=effect, multiple=multiple, seed=seed, verdict="failed", named="", set="", outcome="failed", chi=nan, null=nan, held_before=nan, held_after=nan, held_null=nan,
                   worst_bias_before=nan, worst_bias_after=nan, size=nan, deviation=nan, planted=nan, inside=nan, kappa=nan, p=nan, seconds=nan, chi_squared="", cosine="", bic="")
        if result == "refused":
            row |= dict(verdict="refused", outcome="refused")
        elif result is not None:
            self.formula_for |= {one["name"]: one["formula_for"] for one in result["before"]["candidates"] if "formula_for" in one}
            named, chosen, verdict = result["named"], result["set"], result["verdict"]
            row |= dict(verdict=verdict, named=" + ".join(named), set=", ".join(chosen), outcome=self.outcome(kind, effect, verdict, named, chosen), chi=result["before"]["chi"]["fitted"],
                        null=result["before"]["chi"]["null_fitted"], held_before=result["before"]["chi"]["held_out"], held_after=result["after"]["chi"]["held_out"],
                        held_null=result["after"]["chi"]["null_held_out"], worst_bias_before=self.bias(result["before"]), worst_bias_after=self.bias(result["after"]), seconds=result["time"]["value"])
            candidates = {one["name"]: one for one in result["before"]["candidates"]}
            if candidates:
                row["p"] = min(1.0, len(candidates) * min(one["p"] for one in candidates.values()))
                # What simpler methods would have said: chi^2 of white noise at 5 % and then the best cosine; forward selection by BIC.
                cosine = max(candidates.values(), key=lambda one: one["cosine"])["name"]
                alarm = result["before"]["baselines"]["chi_squared_p"] < 0.05
                bic = result["before"]["baselines"]["bic"]
                said = lambda names: self.outcome(kind, effect, "attributed" if names else "nothing found", names, names)
                row |= dict(chi_squared="alarm" if alarm else "nothing", cosine=said([cosine] if alarm else []), bic=said(bic))
            if effect in candidates:
                row["kappa"] = candidates[effect]["kappa"]
            found = result["after"]["parameters"].get(parameter) if parameter and row["outcome"] == "right" else None
            if found:
                size = next(iter(planted.values()))
                row |= dict(size=found["value"], deviation=found["standard_deviation"], planted=size, inside=int(abs(found["value"] - size) < 1.96 * found["standard_deviation"]))
            self.invisible |= set(result["invisible"])
            if kind == "null":
                self.off.append({n: (one["value"] / self.truth[n] - 1.0, (one["value"] - self.truth[n]) / one["standard_deviation"]) for n, one in result["after"]["parameters"].items() if n in self.truth})
        self.rows.append(row)
        print(f"{kind:8} {effect:24} {multiple:6} seed {seed}: {row['verdict']:14} {row['outcome']:18} {row['set'] or row['named']:32} {row['seconds']:5.0f} s", flush=True)
        return result

    def outcome(self, kind, effect, verdict, named, chosen):
        if kind == "null":
            return "nothing" if verdict == "nothing found" else "false alarm"
        if kind in ("outside", "without", "fault"):
            function = self.formula_for.get(effect)
            sure = named[:-1] if verdict == "ambiguous" else [*named, *chosen]  # one of the set is the last
            another = function and all(self.formula_for.get(name) == function for name in sure) and function in map(self.formula_for.get, [*sure, *chosen])
            return {"nothing found": "missed", "unexplained": "unexplained"}.get(verdict, "another formula" if another else "wrong")
        if verdict == "nothing found":
            return "missed"
        if verdict == "unexplained":
            return "unexplained"
        parts = effect.split(" + ")
        if len(parts) > 1:
            return "right" if set(parts) == set(named) else "in the set" if set(parts) <= set(named) | set(chosen) else "half" if set(parts) & set(named) else "wrong"
        if verdict == "ambiguous" and effect in chosen:
            return "in the set"
        if effect in named:
            return "right" if len(named) == 1 else "right and more"
        return "wrong"

    def bias(self, model):
        its = [abs(model["parameters"][n]["value"] / v - 1.0) for n, v in self.truth.items() if n in model["parameters"]]
        return max(its, default=math.nan)

    def report(self):
        with open(self.folder / "trials.csv", "w", newline="") as stream:
            writer = csv.DictWriter(stream, self.rows[0].keys())
            writer.writeheader()
            writer.writerows(self.rows)
        lines = ["| trial | n | found | right, alone | in the set, or with another | unexplained | missed | another formula for the same function | wrong | refused | failed |", "|---|---|---|---|---|---|---|---|---|---|---|"]
        title = lambda kind, m: {"outside": "outside the library", "pair": "two at once", "without": "10 × MDE, not among the candidates", "fault": "a fault of the test"}.get(kind) or {"usual": "an engineer's size", "-": "law or mesh"}.get(m, f"{m} × MDE")
        for kind, multiple in dict.fromkeys((r["kind"], r["multiple"]) for r in self.rows if r["kind"] != "null"):
            its = [r for r in self.rows if r["kind"] == kind and r["multiple"] == multiple]
            count = lambda *names: sum(r["outcome"] in names for r in its)
            lines.append(f"| {title(kind, multiple)} | {len(its)} | {len(its) - count('missed', 'failed')} | {count('right')} | {count('in the set', 'right and more', 'half')} | {count('unexplained')} |"
                         f" {count('missed')} | {count('another formula')} | {count('wrong')} | {count('refused')} | {count('failed')} |")
        nulls = [r for r in self.rows if r["kind"] == "null"]
        lines.append(f"\nFalse alarms: {sum(r['outcome'] != 'nothing' for r in nulls)} of {len(nulls)}. Invisible: {', '.join(sorted(self.invisible)) or 'none'}.")
        if self.off:
            mean = lambda n, k: np.mean([one[n][k] for one in self.off])
            rms = lambda n: np.sqrt(np.mean([one[n][1] ** 2 for one in self.off]))
            lines.append("Without any effect, parameters off in the mean (in standard deviations; rms): " + ", ".join(f"{n} {100 * mean(n, 0):+.2f} % ({mean(n, 1):+.1f}; {rms(n):.1f})" for n in self.off[0]) + ".")
        named = [r for r in self.rows if r["kind"] == "effect" and r["outcome"] in ("right", "in the set")]
        if named:
            lines.append(f"Held-out χ within the null's 95 % (5 % more allowed) after an attribution: {sum(r['held_after'] <= 1.05 * r['held_null'] for r in named)} of {len(named)}.")
        cover = [r["inside"] for r in self.rows if r["inside"] == r["inside"]]
        if cover:
            lines.append(f"The size's 95 % interval covers the truth: {sum(cover)} of {len(cover)}.")
        big = [r for r in self.rows if r["multiple"] == "50" and r["outcome"] == "right"]
        if big:
            lines.append(f"Worst bias of a parameter at 50 × MDE, median: {100 * np.median([r['worst_bias_before'] for r in big]):.2f} % before, {100 * np.median([r['worst_bias_after'] for r in big]):.2f} % after.")
        lines += self.targets() + self.baselines()
        text = "\n".join(lines)
        (self.folder / "table.md").write_text(text + "\n")
        print("\n" + text)

    def targets(self):
        """The targets of a whole suite, one line each: asked, found."""
        ask = []
        share = lambda text, good, all_, least: ask.append((text, f"{least:.0%} or more", f"{good} of {all_} ({good / all_:.0%})", good >= least * all_)) if all_ else None
        seen = [r for r in self.rows if r["kind"] == "effect" and r["kappa"] == r["kappa"] and r["kappa"] > 0.05 and r["multiple"] in ("3", "10", "50")]
        named = ("right", "in the set", "right and more")
        share("truth in the set at 3 × MDE and more, κ > 0.05", sum(r["outcome"] in named for r in seen), len(seen), 0.9)
        ten = [r for r in seen if r["multiple"] == "10"]
        share("alone and right at 10 × MDE", sum(r["outcome"] == "right" for r in ten), len(ten), 0.8)
        something = [r for r in self.rows if r["kind"] != "null"]
        wrong = sum(r["outcome"] in ("wrong", "right and more") for r in something)
        if something:
            another = sum(r["outcome"] == "another formula" for r in something)
            ask.append(("a wrong name, one beside the right one included", "2 % or less", f"{wrong} of {len(something)} ({wrong / len(something):.1%}); besides, another formula for the same function {another}", wrong <= 0.02 * len(something)))
        attributed = [r for r in self.rows if r["kind"] != "null" and r["verdict"] == "attributed"]
        share("held-out χ within the null's 95 % after an attribution", sum(r["held_after"] <= r["held_null"] for r in attributed), len(attributed), 0.9)
        fifty = [r["worst_bias_before"] / max(1e-12, r["worst_bias_after"]) for r in seen if r["multiple"] == "50" and r["outcome"] in named]
        if fifty:
            ask.append(("worst bias of a parameter at 50 × MDE, before over after, median", "10 or more", f"{np.median(fifty):.1f}", np.median(fifty) >= 10))
        cover = [r["inside"] for r in self.rows if r["inside"] == r["inside"]]
        if cover:
            ask.append(("the size's 95 % interval covers the truth", "90 to 98 %", f"{sum(cover)} of {len(cover)} ({sum(cover) / len(cover):.0%})", 0.9 <= sum(cover) / len(cover) <= 0.98))
        pairs = [r for r in self.rows if r["kind"] == "pair"]
        share("two at once, both named", sum(r["outcome"] in ("right", "in the set") for r in pairs), len(pairs), 0.7)
        return ["", "| target | asked | found | met |", "|---|---|---|---|"] + [f"| {text} | {asked} | {found} | {'yes' if met else 'no'} |" for text, asked, found, met in ask]

    def baselines(self):
        """The loop beside simpler methods on the same residuals and marks."""
        lines = ["", "| of all trials | false alarms | truth named, alone | truth among others | wrong name |", "|---|---|---|---|---|"]
        rows = [r for r in self.rows if r["cosine"]]
        nulls, effects = [r for r in rows if r["kind"] == "null"], [r for r in rows if r["kind"] in ("effect", "pair")]
        something = [r for r in rows if r["kind"] != "null"]
        for title, key in (("this loop", "outcome"), ("χ² of white noise at 5 %, then the best cosine", "cosine"), ("forward selection by BIC", "bic")):
            lines.append(f"| {title} | {sum(r[key] == 'false alarm' for r in nulls)} of {len(nulls)} | {sum(r[key] == 'right' for r in effects)} of {len(effects)} |"
                         f" {sum(r[key] in ('in the set', 'right and more', 'half') for r in effects)} | {sum(r[key] == 'wrong' for r in something)} of {len(something)} |")
        return lines

    def fail_unless_right(self, at_most_not_alone=1):
        bad = [r for r in self.rows if r["outcome"] in ("wrong", "right and more", "failed", "false alarm") or (r["outcome"] == "missed" and r["kind"] != "outside")]
        effects = [r for r in self.rows if r["kind"] == "effect"]
        right = sum(r["outcome"] in ("right", "in the set") for r in effects)
        if bad or right < len(effects) - at_most_not_alone:
            sys.exit(f"{len(bad)} bad outcomes, {right} of {len(effects)} effects named")
