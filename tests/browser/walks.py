"""Walks for the viewer, written by hand: the text that its links hold (webviewer/src/walk/walk.ts has the format)."""

import base64
import zlib

import numpy as np

VERSION, TURN = 1, 65536


def encode_walk(rows: np.ndarray, *, ms: float) -> str:
    """Return the walk as `farfield.replay` takes it.

    rows  (N,6) f8: position in scene metres and direction, N >= 2, at equal times
    ms    between two of them
    """
    direction = rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
    yaw = np.unwrap(np.arctan2(-direction[:, 0], -direction[:, 2]))
    pitch = np.arcsin(np.clip(direction[:, 1], -1, 1))
    columns = [ms * np.arange(len(rows)), *(1000 * rows[:, :3].T), yaw * TURN / (2 * np.pi), pitch * TURN / (2 * np.pi)]
    whole = np.round(np.stack(columns, 1)).astype(np.int64)
    out = bytearray([VERSION])
    for value in [len(rows), *(_zigzag(x) for x in np.diff(whole, axis=0, prepend=0).ravel().tolist())]:
        while value >= 128:
            out.append(value % 128 | 128)
            value //= 128
        out.append(value)
    out += zlib.crc32(out).to_bytes(4, "little")
    return base64.urlsafe_b64encode(out).decode().rstrip("=")


def _zigzag(step: int) -> int:
    return -2 * step - 1 if step < 0 else 2 * step
