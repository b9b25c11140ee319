"""The stage names: table value, task name, metric label, folder and test folder."""

from enum import StrEnum


class Stage(StrEnum):
    """The stages in the order in which a job passes them."""

    SCENE = "scene"
    HIERARCHY = "hierarchy"
    DETAIL = "detail"
    RENDERTIME = "rendertime"
    VISIBILITY = "visibility"
    VIEWSPACE = "viewspace"
    CANDIDATES = "candidates"
    PLACEMENT = "placement"
    BAKE = "bake"
    REPAIR = "repair"
    BOUND = "bound"
    PLACEMENTDB = "placementdb"
    EVALUATION = "evaluation"
    PROOF = "proof"


class Queue(StrEnum):
    """The worker queues, by capability."""

    CPU = "cpu"
    OPTIMIZER = "optimizer"
    GL = "gl"


RUN_SHARD = "farfield.run_shard"  # the one task: its message carries a shard id and nothing else
