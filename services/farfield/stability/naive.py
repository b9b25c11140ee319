"""The greedy without its trick: every candidate is scored anew before each choice. For `farfield stability` and its test.

Gain of candidate i in view v: what it saves there beyond what the impostors of clusters inside its own save already, at
most what v is over; nothing under an impostor of a larger cluster. The best gain per byte is taken, ties by id.
"""

from fractions import Fraction

import numpy as np

from farfield.candidates.model import Candidates


def greedy(candidates: Candidates, *, excess: np.ndarray, end: np.ndarray) -> list[int]:
    """Return the candidates in the order chosen. excess (V,) i64 >= 0; end (C,) of `antichain.subtree_end`."""
    of = np.repeat(np.arange(len(candidates.cluster)), np.diff(candidates.row))
    cluster, view, saved = candidates.cluster[of], candidates.view, candidates.saved.astype(np.int64)
    entries = [np.flatnonzero(view == v) for v in range(len(excess))]
    shown: list[dict[int, int]] = [{} for _ in excess]  # of a view: candidate -> what it saves there
    left, gain = excess.astype(np.int64).copy(), np.minimum(saved, excess[view])
    steps: list[int] = []
    while True:
        score = np.zeros(len(candidates.cluster), np.int64)
        np.add.at(score, of, gain)
        if not score.any():
            return steps
        i = max(
            np.flatnonzero(score).tolist(), key=lambda k: (Fraction(int(score[k]), int(candidates.bytes[k])), -k)
        )  # fmt: skip
        steps.append(i)
        mine = candidates.cluster[i]
        for e in range(int(candidates.row[i]), int(candidates.row[i + 1])):
            if gain[e] <= 0:
                continue
            v = int(view[e])
            inside = [j for j in shown[v] if mine <= candidates.cluster[j] < end[mine]]
            left[v] -= saved[e] - sum(shown[v].pop(j) for j in inside)
            shown[v][i] = int(saved[e])
            here = entries[v]
            there = cluster[here]
            fresh = saved[here].copy()
            for j, amount in shown[v].items():
                c = candidates.cluster[j]
                fresh -= np.where((there <= c) & (c < end[there]), amount, 0)
                fresh[(c < there) & (there < end[c])] = 0
            gain[here] = np.clip(fresh, 0, max(int(left[v]), 0))
