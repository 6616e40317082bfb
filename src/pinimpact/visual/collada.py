"""Collada meshes in the form that meshcat's viewer shows whole."""

from __future__ import annotations

import copy
from xml.etree import ElementTree

NAMESPACE = "http://www.collada.org/2005/11/COLLADASchema"
_TAG = f"{{{NAMESPACE}}}"
_PRIMITIVES = tuple(_TAG + name for name in ("triangles", "polylist", "polygons", "lines"))


def one_material_per_mesh(document: str) -> str:
    """Return a Collada document with its meshes split by material.

    Of a mesh with several materials the viewer drops all but one, with the triangles that wear them.
    """
    ElementTree.register_namespace("", NAMESPACE)
    root = ElementTree.fromstring(document)
    library = root.find(f"{_TAG}library_geometries")
    if library is None:
        return document
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
