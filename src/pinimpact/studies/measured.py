"""What identifies the measurements of a fit: equal ones can be compared in pairs."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np

from ..arrays import Integers
from ..errors import InputError


def digests(*columns: Any) -> tuple[bytes, ...]:
    """Return a digest of each row of some columns, sequences of n arrays, numbers or names."""
    found = []
    for row in zip(*columns, strict=True):
        digest = hashlib.blake2b(digest_size=16)
        for part in row:
            digest.update(np.ascontiguousarray(part).tobytes())
        found.append(digest.digest())
    return tuple(found)


def numbered(labels: Sequence[Hashable], rows: Sequence[bytes]) -> Integers:
    """Return the index of the group (n,) of each row, from labels and digests of n rows.

    If each group is given k times, under other labels, its copies have one index: they are one observation,
    and say nothing about the scatter between groups. Single groups with equal rows stay apart, because
    rounded measurements may agree.
    """
    content: dict[Hashable, list[bytes]] = {}
    for label, row in zip(labels, rows, strict=True):
        if label != label:
            raise InputError("group: NaN given as a label; numbers or names are expected", value=label)
        content.setdefault(label, []).append(row)
    same = {label: tuple(sorted(of_label)) for label, of_label in content.items()}
    copies = math.gcd(*Counter(same.values()).values())
    seen: Counter[tuple[bytes, ...]] = Counter()
    order: dict[Any, int] = {}
    number = {}
    for label, key in same.items():
        number[label] = order.setdefault((key, seen[key] // copies), len(order))
        seen[key] += 1
    return np.array([number[label] for label in labels], dtype=np.int64)
