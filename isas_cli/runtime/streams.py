"""Seeds: one base seed, one stream per iteration and purpose, no two alike."""

from __future__ import annotations

import hashlib

PURPOSES = (
    "draw",
    "primal",
    "adjoint",
    "stage1_place",
    "stage1_primal",
    "stage1_adjoint",
    "stage1_sign",
    "evaluation",
    "target",
    "coverage",
    "frame",
    "balance_place",
    "balance_adjoint",
    "evaluation_place",
    "snapshot",
    "product_adjoint",
    "variance",
    "cost",
    "offset",
    "offset_look",
    "edge",
    "edge_step",
    "edge_residual",
    "lamp",
    "shadow_edge",
    "shadow_residual",
    "exposure",
    "pose",
    "pose_offset",
    "reflected_edge",
    "reflected",
    "aside",
)
_SLOTS = 32  # purposes per iteration, a power of two, at least len(PURPOSES)
_BLOCK = 2**32 // _SLOTS  # iterations whose slots fit into 32 bits


def _bijection(x: int) -> int:
    """Murmur3's 32-bit finaliser: scatters neighbouring numbers, maps no two to one."""
    x ^= x >> 16
    x = x * 0x85EBCA6B & 0xFFFFFFFF
    x ^= x >> 13
    x = x * 0xC2B2AE35 & 0xFFFFFFFF
    return x ^ x >> 16


def seed(base: int, iteration: int, purpose: str) -> int:
    """The 32-bit seed of ``purpose`` in ``iteration`` of a run with base seed ``base``.

    For one base the map is a bijection on iteration and purpose, so two streams of a run never
    share a seed within a block of 2^27 iterations. Another block shuffles the seeds as another base
    does: two of its streams and this one's meet by chance only, once in 2^32.
    """
    block, within = divmod(iteration, _BLOCK)
    name = f"{base}/{block}" if block else str(base)
    key = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=4).digest(), "little")
    slot = within * _SLOTS + PURPOSES.index(purpose)
    return _bijection((_bijection(slot & 0xFFFFFFFF) + key) & 0xFFFFFFFF)
