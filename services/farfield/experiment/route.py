"""A walk through a view space, made from its boxes alone: where the camera is and where it looks, frame after frame.

Problem  Ways to draw a level are compared along one walk that nobody chose in favour of any, and that every run repeats.
         It is walked: no jumps, so that what one frame shows is mostly what the next one does.
Method   Boxes that touch are neighbours; the walk is a long shortest path between them (from the box farthest from the first
         one to the box farthest from that), through the middle of what neighbours share, at equal steps. In a single box it
         crosses both diagonals. The camera looks along the path and sweeps 75 degrees to both sides, 5 up and down.
Errs     Boxes are convex and each piece has both its ends in one of them: the walk never leaves the view space.
"""

import math
from collections import deque
from itertools import pairwise

import numpy as np

EYE_M = 1.7  # over the floor of a box, where it is that high
SWEEP_RAD, TILT_RAD = math.radians(75), math.radians(5)
SWEEPS = 5  # along a walk
_TOUCH = 1e-6  # of the view space's size


def make_route(boxes: np.ndarray, frames: int) -> np.ndarray:
    """Return (frames,6) f64: position and unit direction, in the boxes' coordinates.

    boxes   (B,2,3) f64, at least one
    frames  at least 2
    """
    points = _points(np.asarray(boxes, dtype=np.float64))
    steps = np.diff(points, axis=0)
    length = np.sqrt((steps**2).sum(1))
    steps, length = steps[length > 0], length[length > 0]
    along = np.concatenate([[0.0], np.cumsum(length)])
    at = np.linspace(0.0, along[-1], frames)
    piece = np.clip(np.searchsorted(along, at, side="right") - 1, 0, max(0, len(steps) - 1))
    if len(steps):
        share = (at - along[piece]) / length[piece]
        position = (
            points[0]
            + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])[piece]
            + share[:, None] * steps[piece]
        )
        ahead = steps[piece]
    else:  # a view space of one point
        position, ahead = np.tile(points[0], (frames, 1)), np.tile([0.0, 0.0, -1.0], (frames, 1))
    phase = 2 * math.pi * SWEEPS * np.linspace(0.0, 1.0, frames)
    yaw = np.arctan2(-ahead[:, 0], -ahead[:, 2]) + SWEEP_RAD * np.sin(phase)
    pitch = TILT_RAD * np.sin(1.7 * phase)
    direction = np.stack([-np.sin(yaw) * np.cos(pitch), np.sin(pitch), -np.cos(yaw) * np.cos(pitch)], 1)
    return np.concatenate([position, direction], 1)


def district(boxes: np.ndarray, most: int) -> np.ndarray:
    """Return (K,) ascending: up to `most` boxes around the one in the middle, neighbours of neighbours first."""
    middle = (boxes[:, 0].min(0) + boxes[:, 1].max(0)) / 2
    first = int(np.argmin(((boxes.mean(1) - middle)[:, [0, 2]] ** 2).sum(1)))
    return np.sort(np.array(_reached(_neighbours(boxes), first)[0][:most]))


def _points(boxes: np.ndarray) -> np.ndarray:
    """Return (P,3): the corners of the walk, P >= 2."""
    near = _neighbours(boxes)
    start = _reached(near, 0)[0][-1]
    order, came_from = _reached(near, start)
    path = [order[-1]]
    while path[-1] != start:
        path.append(came_from[path[-1]])
    if len(path) == 1:
        low, high = boxes[path[0]]
        y = _height(boxes[path[0]])
        inset = [(0.1, 0.1), (0.9, 0.9), (0.9, 0.1), (0.1, 0.9)]
        return np.array([[low[0] + u * (high[0] - low[0]), y, low[2] + v * (high[2] - low[2])] for u, v in inset])
    points = [_standing(boxes[path[0]])]
    for a, b in pairwise(path):
        shared = np.stack([np.maximum(boxes[a, 0], boxes[b, 0]), np.minimum(boxes[a, 1], boxes[b, 1])])
        points += [_standing(shared), _standing(boxes[b])]
    return np.array(points)


def _standing(box: np.ndarray) -> np.ndarray:
    point: np.ndarray = box.mean(0)
    point[1] = _height(box)
    return point


def _height(box: np.ndarray) -> float:
    return float(box[0, 1] + min(EYE_M, (box[1, 1] - box[0, 1]) / 2))


def _neighbours(boxes: np.ndarray) -> list[np.ndarray]:
    """Return for each box those that share more than an upright edge with it, ascending."""
    touch = _TOUCH * float((boxes[:, 1].max(0) - boxes[:, 0].min(0)).max())
    low, high = boxes[:, 0], boxes[:, 1]
    found = []
    for b in range(len(boxes)):
        overlap = np.minimum(high, high[b]) - np.maximum(low, low[b])
        meets = (overlap[:, [0, 2]] >= -touch).all(1) & (overlap[:, [0, 2]].max(1) > touch) & (overlap[:, 1] >= 0)
        meets[b] = False
        found.append(np.flatnonzero(meets))
    return found


def _reached(near: list[np.ndarray], start: int) -> tuple[list[int], dict[int, int]]:
    """Return the boxes in the order of their distance from `start`, and from which each was reached."""
    came_from, order, waiting = {start: start}, [], deque([start])
    while waiting:
        box = waiting.popleft()
        order.append(box)
        for other in near[box].tolist():
            if other not in came_from:
                came_from[other] = box
                waiting.append(other)
    return order, came_from
