#!/usr/bin/python3
"""Tables, plots and the page of tools/reproduce_paper.sh, from what studies.py left in a folder.

Usage: page.py FOLDER        writes fig5.svg, fig6.svg …, rows.csv (every row of the page) and index.html
"""
import csv
import html
import json
import math
import pathlib
import re
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as pyplot
import numpy

NAMES = {"E": "E", "S_y": "S_y", "H": "H", "delta": "δ"}
KINEMATICS = {"plane_stress": "plane stress", "3d": "3D"}
PAPER = {"plane_stress": {"E": (0.15, 0.009), "S_y": (0.12, 0.017), "H": (0.9, 0.045), "delta": (0.6, 0.008)},  # mean, deviation [%]
         "3d": {"E": (0.07, 0.012), "S_y": (0.16, 0.017), "H": (1.9, 0.01), "delta": (1.3, 0.012)}}
TARGET = {kinematics: {name: min(mean, 0.5) for name, (mean, _) in paper.items()} for kinematics, paper in PAPER.items()}
PAPER_ALPHA = {1e-4: {"E": 0.15, "S_y": 0.62}, 0.0: {"E": 0.11, "S_y": 0.12}}
DYNAMIC = 255  # of the images [grey level]


def read(file):
    if not file.exists():
        return []
    with open(file) as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        for key, value in row.items():
            try:
                row[key] = float(value)
            except ValueError:
                pass
    return rows


def verdict(value, target):
    return "met" if value <= target else "missed"


class Page:
    def __init__(self, folder):
        self.folder = folder
        self.runs, self.iterations, self.errors = (read(folder / f"{name}.csv") for name in ("runs", "iterations", "correlation_error"))
        self.rows, self.parts = [], []
        pyplot.rcParams.update({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "lines.markersize": 4, "svg.fonttype": "none"})

    def of(self, study, kinematics, parameter=None, name=None):
        return [r for r in self.runs if r["study"] == study and r["kinematics"] == kinematics and
                (parameter is None or r["parameter"] == parameter) and (name is None or re.fullmatch(name, r["name"]))]

    def table(self, head, rows):
        cells = lambda tag, row: "".join(f"<{tag}{' class=' + c if c in ('met', 'missed') else ''}>{html.escape(c)}</{tag}>" for c in map(str, row))
        self.parts.append("<table><tr>" + cells("th", head) + "</tr>" + "".join(f"<tr>{cells('td', r)}</tr>" for r in rows) + "</table>")

    def compare(self, title, rows):
        """rows: what, target, paper, here, verdict."""
        if not rows:
            self.say("Not run.")
            return
        self.table(("", "target", "paper", "here", ""), rows)
        self.rows += [(title, *row) for row in rows]

    def heading(self, text):
        self.parts.append(f"<h2>{html.escape(text)}</h2>")

    def say(self, text):
        self.parts.append(f"<p>{html.escape(text)}</p>")

    def figure(self, name, caption):
        pyplot.tight_layout()
        pyplot.savefig(self.folder / f"{name}.svg")
        pyplot.savefig(self.folder / f"{name}.png", dpi=130)
        pyplot.close()
        svg = (self.folder / f"{name}.svg").read_text()
        svg = self.own_ids(re.sub(r"^.*?(<svg)", r"\1", svg, flags=re.S), name)
        self.parts.append(f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>")

    @staticmethod
    def own_ids(svg, name):
        """Identifiers of one drawing must not meet those of another on the same page."""
        svg = re.sub(r'\bid="', f'id="{name}_', svg)
        svg = re.sub(r'href="#', f'href="#{name}_', svg)
        return re.sub(r"url\(#", f"url(#{name}_", svg)

    def alpha(self):
        self.heading("Fig. 5: error against α (plane stress, from 90 %)")
        runs = self.of("alpha", "plane_stress")
        limit = {name: self.of("starts", "plane_stress", name, f"{name}_0.9") for name in ("E", "S_y")}
        if not runs or not all(limit.values()):
            return self.say("Not run.")
        figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.2))
        rows = []
        for name, axis in zip(("E", "S_y"), axes):
            mine = sorted((r for r in runs if r["parameter"] == name), key=lambda r: r["alpha"])
            shown = [r for r in mine if math.isfinite(r["error_percent"])]
            axis.loglog([r["alpha"] for r in shown], [abs(r["error_percent"]) for r in shown], "o-", label="here")
            axis.axhline(abs(limit[name][0]["error_percent"]), color="C0", ls=":", label="here, α → 0")
            axis.plot([1e-4], [PAPER_ALPHA[1e-4][name]], "s", color="C3", label="paper")
            axis.axhline(PAPER_ALPHA[0.0][name], color="C3", ls=":", label="paper, α → 0")
            axis.set(xlabel="α", ylabel=f"|error of {NAMES[name]}| [%]")
            axis.legend(fontsize=7)
            for run in mine + limit[name]:
                at = PAPER_ALPHA.get(run["alpha"], {}).get(name)
                error = run["error_percent"]
                here = "did not converge" if not math.isfinite(error) else f"{error:+.3f} %"
                rows.append((f"{NAMES[name]}, α {'→ 0' if run['alpha'] == 0 else format(run['alpha'], 'g')}", f"≤ {at} %" if at else "–",
                             f"{at} %" if at else "plot only", here, verdict(abs(error), at) if at else ""))
        self.compare("Fig. 5", rows)
        self.figure("fig5", "Error of E (stage 0) and S_y (stage 1) against the penalty parameter.")

    def starts(self):
        self.heading("Figs 6 and 7: initial guess 80, 90, 110, 120 %")
        rows, floor = [], []
        figure, axes = pyplot.subplots(1, 4, figsize=(11, 3))
        for kinematics, colour in (("plane_stress", "C0"), ("3d", "C1")):
            for name, axis in zip(NAMES, axes):
                paper = PAPER[kinematics][name]
                series = [("sequential", self.of("starts", kinematics, name), "o-")]
                series += [(f"with {NAMES[other]}", self.of("pairs", kinematics, name, rf"{pair}_[\d.]+"), style)
                           for pair, other, style in (("S_y_H", "H" if name == "S_y" else "S_y", "^--"), ("H_delta", "delta" if name == "H" else "H", "v--"))]
                for how, runs, style in series:
                    errors = numpy.array([r["error_percent"] for r in runs])
                    if not len(errors):
                        continue
                    axis.plot([100 * r["start"] for r in runs], errors, style, color=colour, label=f"{KINEMATICS[kinematics]}, {how}", alpha=0.8, lw=1)
                    mean, deviation = abs(errors.mean()), errors.std(ddof=1) if len(errors) > 1 else math.nan
                    target = TARGET[kinematics][name]
                    rows.append((f"{NAMES[name]}, {KINEMATICS[kinematics]}, {how}", f"≤ {target} %", f"{paper[0]} ± {paper[1]} %",
                                 f"{mean:.3f} ± {deviation:.4f} %", verdict(mean, target)))
                if self.of("starts", kinematics, name):
                    for sign in (-1, 1):
                        axis.axhline(sign * paper[0], color=colour, ls=":", lw=1, label=f"± paper, {KINEMATICS[kinematics]}" if sign > 0 else None)
                axis.set(title=NAMES[name], xlabel="start [% of the true value]", ylabel="error [%]")
                axis.ticklabel_format(useOffset=False)
        axes[0].legend(fontsize=5)
        axes[2].legend(fontsize=5)
        self.compare("Figs 6, 7", rows)
        self.say("Error: absolute mean over the starts ± standard deviation over them. The paper gives figures for the sequential identification; "
                 "for the pairs it says \"similar\". An error of E near its noise (Eq. 14, below) is that of this one draw of the images.")
        self.figure("fig6", "Error of every parameter against the initial guess.")
        for kinematics in KINEMATICS:
            for name in NAMES:
                base = self.of("starts", kinematics, name, f"{name}_0.9")
                cells = [self.of("floors", kinematics, name, f"{case}_{name}") for case in ("ends_without_noise", "ends_true", "clean", "clean_ends_true")]
                if base and all(cells):
                    floor.append((f"{NAMES[name]}, {KINEMATICS[kinematics]}", f"{base[0]['noise_percent']:.4f}",
                                  *(f"{r[0]['error_percent']:+.4f}" for r in [base] + cells)))
        if floor:
            self.parts.append("<h3>What sets the floor: errors [%] from 90 % with one source switched off at a time</h3>")
            self.table(("", "noise, Eq. 14", "as measured", "ends driven by DIC of noise-free images", "ends driven by the true displacement",
                        "images without noise", "without noise, true ends"), floor)
            self.say("The last column has neither noise nor boundary error: what is left is the identification's coarser mesh of other elements, the 8 bits, and the "
                     "interpolation of the true displacement between the two meshes' nodes.")

    def convergence(self):
        self.heading("Figs 8–10: parameters against iterations")
        rows = []
        for kinematics in KINEMATICS:
            for study, label, names, target, paper in (("starts", "sequential", NAMES, 5, "3 to 7"), ("pairs", "simultaneous", ("S_y_H", "H_delta"), 6, "15 (10 acceptable)")):
                for name in names:
                    runs = {r["name"]: r["iterations"] for r in self.of(study, kinematics, name=rf"{name}_[\d.]+")}
                    if runs:
                        most = max(runs.values())
                        rows.append((f"{label} {NAMES.get(name, name.replace('_H', ', H').replace('H_delta', 'H, δ'))}, {KINEMATICS[kinematics]}", f"≤ {target}", paper,
                                     " ".join(f"{v:.0f}" for v in runs.values()), verdict(most, target)))
        self.compare("Figs 8-10", rows)
        if not self.iterations:
            return
        panels = [("starts", "S_y", ("S_y",)), ("starts", "H", ("H",)), ("pairs", "S_y_H", ("S_y", "H")), ("pairs", "H_delta", ("H", "delta"))]
        panels = [panel for panel in panels if self.of(panel[0], "plane_stress", name=rf"{panel[1]}_[\d.]+")]
        if not panels:
            return
        figure, axes = pyplot.subplots(1, len(panels), figsize=(2.75 * len(panels) + 1, 3), sharey=True, squeeze=False)
        axes = axes[0]
        for axis, (study, name, parameters) in zip(axes, panels):
            for k, start in enumerate((0.8, 0.9, 1.1, 1.2)):
                series = [r for r in self.iterations if r["study"] == study and r["kinematics"] == "plane_stress" and r["name"] == f"{name}_{start}"]
                for parameter, style in zip(parameters, ("o-", "s--")):
                    axis.plot([r["iteration"] for r in series], [r[parameter] for r in series], style, color=f"C{k}",
                              label=f"{NAMES[parameter]} from {100 * start:.0f} %")
            axis.set(title=" and ".join(NAMES[p] for p in parameters), xlabel="iteration")
            axis.legend(fontsize=6)
        axes[0].set_ylabel("value / true value")
        self.figure("fig8", "Plane stress: sequential S_y and H (Fig. 9), simultaneous (S_y, H) and (H, δ) (Figs 8, 10).")

    def correlation(self):
        self.heading("Fig. 11: mean correlation error (H in plane stress)")
        base = [r for r in self.errors if r["study"] == "starts" and r["kinematics"] == "plane_stress"]
        if not base:
            return self.say("Not run.")
        figure, axes = pyplot.subplots(1, 2, figsize=(10, 3.6))
        for start in (0.8, 0.9, 1.1, 1.2):
            series = [r for r in self.iterations if r["kinematics"] == "plane_stress" and r["name"] == f"H_{start}"]
            axes[0].semilogy([r["iteration"] for r in series], [100 * r["residual"] / DYNAMIC for r in series], "o-", label=f"from {100 * start:.0f} %")
        axes[0].set(xlabel="iteration", ylabel="mean correlation error [% of the dynamic]")
        axes[0].legend(fontsize=7)
        # Each case beside pure DIC on the same images.
        cases = {"as measured": "H_0.9", "ends driven by DIC of noise-free images": "ends_without_noise_H", "ends driven by the true displacement": "ends_true_H",
                 "images without noise": "clean_H", "images without noise, true ends": "clean_ends_true_H"}
        table = []
        for k, (label, name) in enumerate(cases.items()):
            mine = [r for r in self.errors if r["kinematics"] == "plane_stress" and r["name"] == name]
            if not mine:
                continue
            strain, model, dic = (numpy.array([r[key] for r in mine]) for key in ("mean_strain", "model", "dic"))
            axes[1].plot(100 * strain, 100 * model / DYNAMIC, "o-", color=f"C{k}", ms=3, label=label)
            if name in ("H_0.9", "clean_H"):
                axes[1].plot(100 * strain, 100 * dic / DYNAMIC, "x:", color=f"C{k}", ms=4, label="pure DIC" + (", without noise" if name == "clean_H" else ""))
            rms = lambda v: 100 * math.sqrt(numpy.mean(v ** 2)) / DYNAMIC
            own = math.sqrt(max(0.0, rms(model) ** 2 - rms(dic) ** 2))
            table.append((label, f"{rms(model):.3f}", f"{rms(dic):.3f}", f"{rms(model) - rms(dic):.3f}", f"{own:.3f}", f"{100 * model[-1] / DYNAMIC:.3f}", f"{100 * dic[-1] / DYNAMIC:.3f}"))
        axes[1].set(xlabel="mean strain [%]", ylabel="mean correlation error [% of the dynamic]")
        axes[1].legend(fontsize=6)
        first = [float(c) for c in table[0][1:]]
        self.compare("Fig. 11", [("mean correlation error of I-MIC", "–", "1.8 %", f"{first[0]:.3f} %", ""),
                                 ("gap to pure DIC", "explained", "grows with the strain", f"{first[2]:.3f} %", "")])
        self.table(("[% of the dynamic], all frames", "I-MIC", "pure DIC", "gap", "√(I-MIC² − DIC²)", "I-MIC, last frame", "pure DIC, last frame"), table)
        self.say("The images are smoothed by dic.low_pass before they are compared, which takes noise away from both curves; the paper's are not said to be. "
                 "√(I-MIC² − DIC²) is what the model adds to the noise.")
        self.figure("fig11", "Mean correlation error against iterations, and against the mean strain for the identified H.")

    def others(self):
        for title, name in (("Sec. 5, Table 1: several cameras (tools/table1.sh)", "table1"), ("Covariance: scatter over noise draws against prediction", "covariance"),
                            ("Measured: stereo_chessboard", "stereo_chessboard"), ("Measured: gt4_stereo", "gt4_stereo")):
            self.heading(title)
            file = self.folder / f"{name}.txt"
            if not file.exists():
                self.say("Not run.")
                continue
            lines = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in file.read_text().splitlines()]
            if name == "covariance":
                lines = [line for line in lines if not line.startswith(("Note:", "[=", "[-", "[ RUN"))]
            self.parts.append("<pre>" + html.escape("\n".join(lines[-60:])) + "</pre>")

    def time(self):
        """What the studies took, from the files `seconds` beside them."""
        self.heading("Processor time")
        rows = [(f"{KINEMATICS[file.parts[-3]]}, virtual test {file.parts[-2]}", float(file.read_text())) for file in sorted(self.folder.glob("*/*/seconds"))
                if (file.parent / "virtual.yaml").exists()]
        for kinematics in KINEMATICS:
            for study in dict.fromkeys(r["study"] for r in self.runs if r["kinematics"] == kinematics):
                runs = {r["name"]: r["seconds"] for r in self.of(study, kinematics)}
                rows.append((f"{KINEMATICS[kinematics]}, {study}: {len(runs)} identifications", sum(runs.values())))
        rows += [(file.stem, sum(map(float, file.read_text().split()))) for file in sorted(self.folder.glob("*.seconds"))]
        total = sum(seconds for _, seconds in rows)
        self.table(("", "s"), [(what, f"{seconds:.0f}") for what, seconds in rows] + [("all", f"{total:.0f}")])
        self.rows.append(("Time", "processor time, half of it", "< 20 min" if self.quick else "–", "–", f"{total / 120:.1f} min", verdict(total / 120, 20) if self.quick else ""))
        with open(self.folder / "times.csv", "w", newline="") as stream:
            csv.writer(stream).writerows([("study", "seconds"), *rows])

    def write(self):
        setup = json.loads((self.folder / "setup.json").read_text()) if (self.folder / "setup.json").exists() else {}
        self.alpha()
        self.starts()
        self.convergence()
        self.correlation()
        self.others()
        self.quick = not setup.get("full", False)
        self.time()
        missed = [f"{title}: {row[0]}" for title, *row in self.rows if row[-1] == "missed"]
        judged = [row for row in self.rows if row[-1] in ("met", "missed")]
        head = f"<p><b>{len(judged) - len(missed)} of {len(judged)} targets met.</b>" + (" Missed: " + html.escape("; ".join(missed)) + "." if missed else "") + "</p>"
        if setup:
            head += (f"<p>Virtual tests of {setup['size'][0]} × {setup['size'][1]} px, "
                     f"{setup['frames']['plane_stress']} loaded frames (3D: {setup['frames']['3d']}); E on images of its own at 22.5 µm a pixel, 5 frames; noise of 1 % of the dynamic, 8 bits; made on a mesh of "
                     f"{setup['mesh_generate_mm'][0]}–{setup['mesh_generate_mm'][1]} mm and {setup['lengths_mm'][0]} mm length, identified on {setup['mesh_identify_mm'][0]}–{setup['mesh_identify_mm'][1]} mm, "
                     f"{setup['lengths_mm'][1]} mm and other elements.</p>")
        style = ("body{font:15px/1.45 system-ui,sans-serif;max-width:1150px;margin:2em auto;padding:0 1em;color:#222}table{border-collapse:collapse;margin:1em 0}"
                 "th,td{border:1px solid #ccc;padding:3px 9px;text-align:left;font-size:14px}th{background:#f3f3f3}.met{background:#dff2df}.missed{background:#f8dcdc}"
                 "figure{margin:1em 0}svg{max-width:100%;height:auto}figcaption{color:#555;font-size:13px}pre{background:#f6f6f6;padding:8px;overflow:auto;font-size:12px}")
        (self.folder / "index.html").write_text(f"<!doctype html><html lang=en><meta charset=utf-8><title>The paper again</title><style>{style}</style>"
                                                f"<h1>The paper's virtual tests again</h1>{head}{''.join(self.parts)}</html>")
        with open(self.folder / "rows.csv", "w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(("figure", "quantity", "target", "paper", "here", "verdict"))
            writer.writerows(self.rows)
        for title, *row in self.rows:
            print(f"{title:10} {row[0]:40} target {row[1]:10} paper {row[2]:18} here {row[3]:22} {row[4]}")
        print(f"{self.folder / 'index.html'}")


Page(pathlib.Path(sys.argv[1])).write()
