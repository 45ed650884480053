"""Snapshots: the state of an object as plain values, how they become bytes, and how they are taken back.

Whoever owns state has ``state() -> Snapshot`` and ``restore(snapshot)``. A snapshot holds numbers,
text, bytes, lists, dicts with text keys and numpy arrays of float64, nothing else, so that reading one runs no code of
anybody's. It may share memory with its owner: make bytes of it before the owner goes on.
"""

from __future__ import annotations

from math import prod
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

Snapshot = dict[str, Any]

ARRAY = 1
"""MessagePack's extension type for an array: its shape in MessagePack, then its numbers, little-endian float64."""


class SnapshotError(ValueError):
    """Bytes that are no snapshot, or values that do not fit the object that is to take them back."""


def pack(snapshot: Snapshot) -> bytes:
    """The snapshot as bytes; the same for the same values."""
    packed: bytes = msgpack.packb(snapshot, default=_pack_array)
    return packed


def unpack(data: bytes) -> Snapshot:
    """The snapshot in these bytes. Raises :class:`SnapshotError` if there is none."""
    try:
        found = msgpack.unpackb(data, ext_hook=_unpack_array)
    except (ValueError, TypeError, msgpack.exceptions.UnpackException) as error:
        raise SnapshotError(f"not a snapshot: {error}") from None
    if not isinstance(found, dict):
        raise SnapshotError(f"not a snapshot: got a {type(found).__name__}, expected a map")
    return found


def _pack_array(value: object) -> Any:
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        shape: bytes = msgpack.packb(list(value.shape))
        return msgpack.ExtType(ARRAY, shape + value.astype("<f8").tobytes())
    raise TypeError(f"a snapshot cannot hold a {type(value).__name__}")  # a bug of ours


def _unpack_array(code: int, data: bytes) -> NDArray[np.float64]:
    if code != ARRAY:
        raise ValueError(f"extension type {code}, expected {ARRAY}")
    unpacker = msgpack.Unpacker()
    unpacker.feed(data)
    shape = unpacker.unpack()
    numbers = data[unpacker.tell() :]
    if not isinstance(shape, list) or not all(isinstance(n, int) and n >= 0 for n in shape):
        raise ValueError("an array without a shape")
    if 8 * prod(shape) != len(numbers):
        raise ValueError(f"an array of shape {shape} with {len(numbers)} bytes")
    return np.frombuffer(numbers, "<f8").reshape(shape).astype(np.float64)


def fill(target: NDArray[Any], saved: object) -> None:
    """Write a saved array into the present one, in place. Raises :class:`SnapshotError` if the shapes differ."""
    if not isinstance(saved, np.ndarray):
        raise SnapshotError(f"got a {type(saved).__name__}, expected {target.shape} numbers")
    if saved.shape != target.shape:
        raise SnapshotError(f"got {saved.shape} numbers, expected {target.shape}")
    target[:] = saved


def random_state(stream: np.random.Generator) -> Snapshot:
    """Where a stream of random numbers stands. Its two words of 128 bits are text: MessagePack's integers end at 64."""
    state: Any = stream.bit_generator.state
    words = {name: str(word) for name, word in state["state"].items()}
    return {**words, "has_uint32": state["has_uint32"], "uinteger": state["uinteger"]}


def set_random_state(stream: np.random.Generator, saved: Snapshot) -> None:
    """Put a stream of the same kind there."""
    stream.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": int(saved["state"]), "inc": int(saved["inc"])},
        "has_uint32": saved["has_uint32"],
        "uinteger": saved["uinteger"],
    }
