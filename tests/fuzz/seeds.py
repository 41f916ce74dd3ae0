#!/usr/bin/python3
"""Seed inputs and dictionaries of the fuzzers, from inputs/ and from small files of every kind that the tests read.

Usage: seeds.py FOLDER    makes FOLDER/{case,mesh,loads,image}/ and FOLDER/{case,mesh,loads,image}.dict
"""
import json
import pathlib
import sys

import numpy
from PIL import Image

SOURCE = pathlib.Path(__file__).resolve().parents[2]
CASE = """title: Plate
units: {length: mm, force: N, time: s}
specimen: {mesh: plate.msh, thickness: 8.0, layers: 4, element: hex8, held: bottom, loaded: top, axis: y}
cameras:
  - {name: left, model: telecentric, pixel_size: 0.018, place: {auto: outline}, images: "frame_*.png", reference: 0-1}
loads: {file: loads.csv, image: frame, time: t_s, force: F_N, lag: 0.1}
material: {law: j2, hardening: power_linear, tie_initial_modulus: true,
           parameters: {E: 198e3, nu: 0.25, S_y: 284, H: {value: 1480, lower: 100, upper: 1e4}, delta: 0.042}}
identify:
  functional: force_driven
  held_out: 1
  stages: [{free: [E], frames: "1-2"}, {free: [H, delta], frames: "1-2"}]
effects: {force_zero: {force_offset: 400}, taper: {taper_y: {lower: -0.1, upper: 0.2, free: true}}}
"""


def gmsh_22(cells, nodes, dimension):
    kind, facet = (3, 1) if dimension == 2 else (5, 3)
    names = f'$PhysicalNames\n2\n{dimension - 1} 1 "bottom"\n{dimension} 2 "specimen"\n$EndPhysicalNames\n'
    elements = [f"1 {facet} 2 1 1 " + " ".join(str(n) for n in cells[0][:2 * (dimension - 1)])]
    elements += [f"{2 + i} {kind} 2 2 1 " + " ".join(map(str, cell)) for i, cell in enumerate(cells)]
    return ("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n" + names + f"$Nodes\n{len(nodes)}\n" + "".join(f"{i + 1} {x:g} {y:g} {z:g}\n" for i, (x, y, z) in enumerate(nodes)) +
            f"$EndNodes\n$Elements\n{len(elements)}\n" + "\n".join(elements) + "\n$EndElements\n")


def gmsh_41(cells, nodes, dimension):
    kind = 3 if dimension == 2 else 5
    entities = "0 0 1 0\n1 0 0 0 1 1 0 1 2 0\n" if dimension == 2 else "0 0 0 1\n1 0 0 0 1 1 1 1 2 0\n"
    return (f'$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n{dimension} 2 "specimen"\n$EndPhysicalNames\n$Entities\n{entities}$EndEntities\n'
            f"$Nodes\n1 {len(nodes)} 1 {len(nodes)}\n{dimension} 1 0 {len(nodes)}\n" + "".join(f"{i + 1}\n" for i in range(len(nodes))) +
            "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in nodes) + f"$EndNodes\n$Elements\n1 {len(cells)} 1 {len(cells)}\n{dimension} 1 {kind} {len(cells)}\n" +
            "".join(f"{i + 1} " + " ".join(map(str, cell)) + "\n" for i, cell in enumerate(cells)) + "$EndElements\n")


def abaqus(cells, nodes, dimension):
    kind = "CPS4" if dimension == 2 else "C3D8"
    return ("*HEADING\nplate\n*NODE, NSET=all\n" + "".join(f"{i + 1}, {x:g}, {y:g}, {z:g}\n" for i, (x, y, z) in enumerate(nodes)) + f"*ELEMENT, TYPE={kind}, ELSET=specimen\n" +
            "".join(f"{i + 1}, " + ", ".join(map(str, cell)) + "\n" for i, cell in enumerate(cells)) +
            "*NSET, NSET=bottom\n1, 2\n*NSET, NSET=both, GENERATE\n1, 4, 1\n*NSET, NSET=more\nbottom, 3\n*ELSET, ELSET=first\n1\n"
            "*SURFACE, NAME=face, TYPE=ELEMENT\nfirst, S1\n1, S2\n*INSTANCE, NAME=one, PART=plate\n0., 0., 0.\n*END INSTANCE\n")


def meshes():
    flat = [(x, y, 0) for y in range(2) for x in range(3)]
    quads = [(1, 2, 5, 4), (2, 3, 6, 5)]
    solid = [(x, y, z) for z in range(2) for y in range(2) for x in range(2)]
    hexes = [(1, 2, 4, 3, 5, 6, 8, 7)]
    for write, first, name in ((gmsh_22, "0", "22"), (gmsh_41, "0", "41"), (abaqus, "1", "inp")):
        yield f"quads_{name}", first + write(quads, flat, 2)
        yield f"hex_{name}", first + write(hexes, solid, 3)


def images(folder):
    grey = (numpy.arange(12 * 10).reshape(10, 12) * 2).astype(numpy.uint8)
    deep = (numpy.arange(12 * 10).reshape(10, 12) * 500).astype(numpy.uint16)
    for name, image in (("grey", Image.fromarray(grey)), ("deep", Image.fromarray(deep)),
                        ("colour", Image.fromarray(numpy.dstack([grey] * 3))), ("alpha", Image.fromarray(numpy.dstack([grey] * 4))), ("palette", Image.fromarray(grey).convert("P")),
                        ("bilevel", Image.fromarray(grey).convert("1"))):
        for kind in ("png", "tiff", "bmp"):
            if kind == "bmp" and name in ("deep", "alpha"):
                continue
            image.save(folder / f"{name}.{kind}", kind)
        for packed in ("tiff_lzw", "tiff_deflate", "packbits"):
            if name in ("grey", "deep", "colour"):
                image.save(folder / f"{name}_{packed}.tiff", "tiff", compression=packed)
    # big-endian, one strip, 16 bits
    entries = [(256, 3, 1, 12 << 16), (257, 3, 1, 10 << 16), (258, 3, 1, 16 << 16), (259, 3, 1, 1 << 16), (262, 3, 1, 1 << 16), (273, 4, 1, 8),
               (277, 3, 1, 1 << 16), (278, 3, 1, 10 << 16), (279, 4, 1, 240)]
    directory = len(entries).to_bytes(2, "big") + b"".join(t.to_bytes(2, "big") + k.to_bytes(2, "big") + n.to_bytes(4, "big") + v.to_bytes(4, "big") for t, k, n, v in entries) + bytes(4)
    (folder / "big_endian.tiff").write_bytes(b"MM\0*" + (8 + 240).to_bytes(4, "big") + deep.astype(">u2").tobytes() + directory)


def words_of(schema):
    """Keys and values that the schema of the case file knows."""
    found = set()
    if isinstance(schema, dict):
        found |= set(schema.get("properties", {}))
        found |= {value for value in schema.get("enum", []) if isinstance(value, str)}
        for value in schema.values():
            found |= words_of(value)
    elif isinstance(schema, list):
        for value in schema:
            found |= words_of(value)
    return found


DICTIONARIES = {
    "mesh": ["$MeshFormat\n", "$EndMeshFormat\n", "$PhysicalNames\n", "$Entities\n", "$EndEntities\n", "$Nodes\n", "$EndNodes\n", "$Elements\n", "$EndElements\n", "2.2 0 8\n", "4.1 0 8\n",
             "*NODE", "*ELEMENT", "*NSET", "*ELSET", "*SURFACE", "*INSTANCE", "*INCLUDE", ", TYPE=CPS4", ", TYPE=C3D8", ", GENERATE", ", NSET=", ", ELSET=", ", NAME=", ", INPUT=", "S1", "S6",
             "**", "-1", "0", "1e308", "9223372036854775807", "-9223372036854775808", "2147483647", "4294967296", "nan", "inf", '"', ".", ","],
    "loads": ["frame", "t_s", "F_N", "image_file", "strain", "stress", "x", "y", "u", "v", ",", ";", "\t", '"', '""', "\n", "\r\n", "#", "nan", "inf", "1e308", "1e-320", "-", ":", "2147483647",
              "99999999999", "\xef\xbb\xbf"],
    "image": ["\x89PNG\r\n\x1a\n", "IHDR", "IDAT", "IEND", "PLTE", "tRNS", "BM", "II*\x00", "MM\x00*", "\xff\xff\xff\xff", "\x7f\xff\xff\xff", "\x80\x00\x00\x00", "\x00\x01", "\x01\x00",
              "\x11\x01", "\x17\x01", "\x44\x01", "\x45\x01", "\x02\x01", "\x15\x01"],
}


def write_dictionary(path, words):
    quoted = ("".join(c if 32 <= ord(c) < 127 and c not in '"\\' else f"\\x{ord(c):02x}" for c in word) for word in sorted(set(words)))
    path.write_text("".join(f'"{word}"\n' for word in quoted if word))


def main():
    folder = pathlib.Path(sys.argv[1])
    for name in ("case", "mesh", "loads", "image"):
        (folder / name).mkdir(parents=True, exist_ok=True)
        # What was found once stays among the seeds.
        for found in (SOURCE / "tests/fuzz/found" / name).glob("*"):
            (folder / name / f"found_{found.name}").write_bytes(found.read_bytes())
    (folder / "case/good").write_text(CASE)
    for file in SOURCE.glob("inputs/*/*.yaml"):
        (folder / "case" / f"{file.parent.name}_{file.name}").write_bytes(file.read_bytes())
    for name, text in meshes():
        (folder / "mesh" / name).write_text(text)
    (folder / "loads/loads").write_text('# by a machine\nframe,t_s,F_N,image_file\n0,0,0,a.png\n1,1.5,"1e3",\n2,2.5,+200,"b ""c"".png"\n')
    (folder / "loads/semicolons").write_text("\ufeffframe;t_s;F_N\n3;0;0\n4;1;-3e2\n")
    (folder / "loads/curve").write_text("made by\nstrain\tstress\n0\t0\n0.001\t200\n0.002\t350\n")
    (folder / "loads/points").write_text("x,y,u,v\n0,0,nan,0\n1,0,0.1,0.2\n")
    (folder / "loads/frames").write_text("0,2,7-9,10-40:5")
    images(folder / "image")
    DICTIONARIES["case"] = list(words_of(json.loads((SOURCE / "inputs/case.schema.json").read_text()))) + [
        "plate.msh", "loads.csv", "curve.csv", "frame_*.png", "E", "nu", "S_y", "H", "delta", ": ", "- ", "{", "}", "[", "]", "&a ", "*a", "<<: ", "!!", "|\n", ">\n", "---\n", "1e308", ".inf", "~",
        "99999999999999999999", "-1", "0-1", "from_loads", "../"]
    for name, words in DICTIONARIES.items():
        write_dictionary(folder / f"{name}.dict", words)


main()
