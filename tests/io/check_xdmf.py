#!/usr/bin/python3
"""Checks that an .xdmf file is well-formed and that everything it refers to is in its HDF5 file, with these dimensions.

Usage: check_xdmf.py results.xdmf; prints the number of grids and references, exit status 1 with the first fault."""
import pathlib
import sys
import xml.etree.ElementTree as ElementTree

import h5py
import numpy

path = pathlib.Path(sys.argv[1])
root = ElementTree.parse(path).getroot()
references = 0


def dimensions(item):
    return tuple(int(n) for n in item.get("Dimensions").split())


def heavy(item):
    """Shape of the dataset that a DataItem names."""
    global references
    references += 1
    file, name = item.text.strip().split(":")
    with h5py.File(path.parent / file, "r") as h5:
        shape = h5[name].shape
        kind = {"f": "Float", "i": "Int"}[h5[name].dtype.kind]
    assert shape == dimensions(item), (name, shape, dimensions(item))
    assert kind == item.get("NumberType"), name
    return shape


for grid in root.iter("Grid"):
    if grid.get("GridType") != "Uniform":
        continue
    cells = heavy(grid.find("Topology/DataItem"))
    nodes = heavy(grid.find("Geometry/DataItem"))
    assert cells == (int(grid.find("Topology").get("NumberOfElements")),
                     {"Hexahedron": 8, "Quadrilateral": 4}[grid.find("Topology").get("TopologyType")])
    assert nodes[1] == 3
    assert grid.find("Time") is not None
    for attribute in grid.findall("Attribute"):
        slab = attribute.find("DataItem")
        select, data = slab.findall("DataItem")
        shape = heavy(data)
        start, stride, count = numpy.array([int(n) for n in select.text.split()]).reshape(3, len(shape))
        assert all(start + (count - 1) * stride < shape), attribute.get("Name")
        assert tuple(count[1:]) == dimensions(slab) and count[0] == 1, attribute.get("Name")
        entities = {"Node": nodes[0], "Cell": cells[0]}[attribute.get("Center")]
        assert dimensions(slab) == {"Vector": (entities, 3), "Scalar": (entities,)}[attribute.get("AttributeType")]

assert references > 0
print(len(root.findall(".//Grid[@GridType='Uniform']")), "grids,", references, "references")
