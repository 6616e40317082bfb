"""COLLADA meshes in a form that meshcat's viewer shows completely."""

from __future__ import annotations

import copy
from xml.etree import ElementTree

NAMESPACE = "http://www.collada.org/2005/11/COLLADASchema"
_TAG = f"{{{NAMESPACE}}}"
DIGITS, NORMAL_DIGITS = 5, 3
"""Significant digits of the numbers of a mesh and of its normals: enough for display, for smaller files."""
_PRIMITIVES = tuple(_TAG + name for name in ("triangles", "polylist", "polygons", "lines"))


def for_viewer(document: str) -> str:
    """Return a COLLADA document in a form that meshcat's viewer shows completely.

    The viewer shows only one material of a mesh, so meshes are split by material. It fails if only some
    meshes have texture coordinates, so zeros are added to the others. Numbers are rounded to `DIGITS`.
    """
    ElementTree.register_namespace("", NAMESPACE)
    root = ElementTree.fromstring(document)
    library = root.find(f"{_TAG}library_geometries")
    if library is None:
        return document
    _round(library)
    _add_texture_coordinates(library)
    pieces: dict[str, list[tuple[str, str | None]]] = {}
    for geometry in list(library):
        mesh = geometry.find(f"{_TAG}mesh")
        primitives = [] if mesh is None else [part for part in mesh if part.tag in _PRIMITIVES]
        if len(primitives) < 2:
            continue
        name = geometry.get("id", "")
        pieces[name] = []
        for own, primitive in enumerate(primitives):
            piece = copy.deepcopy(geometry)
            piece.set("id", f"{name}-{own}")
            body = piece.find(f"{_TAG}mesh")
            assert body is not None
            for index, part in enumerate([part for part in body if part.tag in _PRIMITIVES]):
                if index != own:
                    body.remove(part)
            library.append(piece)
            pieces[name].append((f"{name}-{own}", primitive.get("material")))
        library.remove(geometry)
    for node in root.iter(f"{_TAG}node"):
        for instance in node.findall(f"{_TAG}instance_geometry"):
            split = pieces.get(instance.get("url", "").lstrip("#"))
            if split is None:
                continue
            node.remove(instance)
            for name, material in split:
                part = copy.deepcopy(instance)
                part.set("url", f"#{name}")
                for common in part.iter(f"{_TAG}technique_common"):
                    for binding in list(common):
                        if binding.get("symbol") != material:
                            common.remove(binding)
                node.append(part)
    return ElementTree.tostring(root, encoding="unicode")


def _round(library: ElementTree.Element) -> None:
    """Round the numbers of meshes."""
    normal = f".//{_TAG}input[@semantic='NORMAL']"
    normals = {part.get("source", "")[1:] for part in library.iterfind(normal)}
    for source in library.iter(f"{_TAG}source"):
        digits = NORMAL_DIGITS if source.get("id") in normals else DIGITS
        for array in source.iter(f"{_TAG}float_array"):
            array.text = " ".join([f"{float(number):.{digits}g}" for number in (array.text or "").split()])


def _add_texture_coordinates(library: ElementTree.Element) -> None:
    """Add texture coordinates of zero to primitives without any, if other primitives have some."""
    texture = f"{_TAG}input[@semantic='TEXCOORD']"
    surfaces = [part for tag in _PRIMITIVES[:3] for part in library.iter(tag)]
    if not any(part.find(texture) is not None for part in surfaces):
        return
    for geometry in library:
        mesh = geometry.find(f"{_TAG}mesh")
        bare = [
            part for part in (() if mesh is None else mesh) if part in surfaces and part.find(texture) is None
        ]
        if mesh is None or not bare:
            continue
        count = max(int(accessor.get("count", "0")) for accessor in mesh.iter(f"{_TAG}accessor"))
        name = f"{geometry.get('id')}-zero"
        source = ElementTree.Element(f"{_TAG}source", id=name)
        array = ElementTree.SubElement(source, f"{_TAG}float_array", id=f"{name}-array", count=str(2 * count))
        array.text = "0 0 " * count
        common = ElementTree.SubElement(source, f"{_TAG}technique_common")
        accessor = {"source": f"#{name}-array", "count": str(count), "stride": "2"}
        ElementTree.SubElement(common, f"{_TAG}accessor", accessor)
        mesh.insert(0, source)
        for part in bare:
            vertex = part.find(f"{_TAG}input[@semantic='VERTEX']")
            if vertex is not None:
                added = {
                    "semantic": "TEXCOORD",
                    "source": f"#{name}",
                    "offset": vertex.get("offset", "0"),
                    "set": "0",
                }
                part.insert(list(part).index(vertex) + 1, ElementTree.Element(f"{_TAG}input", added))
