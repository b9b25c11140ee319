"""The pipeline as the workers walk it: the steps, how to report, and which stages are special."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from farfield.executor import StageRun
from farfield.pipeline import STEPS
from farfield.stages import Stage
from farfield.steps.model import Inputs, Step
from farfield.store.progress import StageKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Pipeline:
    """What to run. Tests pass their own, of small pure functions."""

    steps: Mapping[Stage, Step]
    report: Callable[[Inputs, Sequence[StageRun]], Mapping[str, Any]]
    optional: frozenset[Stage] = frozenset()  # where one fails for good the job goes on without it
    resumes: frozenset[Stage] = frozenset({Stage.PLACEMENT})  # keeps a checkpoint, which the next attempt goes on from
    isolated: frozenset[Stage] = frozenset()  # parses hostile files: in a child process with limits

    def kinds(self) -> dict[str, StageKind]:
        """Return what moving a job on needs to know."""
        return {
            str(s): StageKind(
                queue=str(step.queue),
                merges=step.merge is not None,
                optional=s in self.optional,
                inputs=tuple(map(str, step.inputs)),
                need=step.need,
            )
            for s, step in self.steps.items()
        }


def load_pipeline(name: str) -> Pipeline:
    """Return the pipeline that "module:attribute" names."""
    module, _, attribute = name.partition(":")
    found = getattr(importlib.import_module(module), attribute)
    assert isinstance(found, Pipeline)
    return found


def _report(inputs: Inputs, stages: Sequence[StageRun]) -> Mapping[str, Any]:
    from farfield.evaluation.report import build_report

    return build_report(inputs, list(stages))


PIPELINE = Pipeline(
    steps=STEPS,
    report=_report,
    optional=frozenset({Stage.EVALUATION, Stage.PROOF}),  # the placement then stands as unproven
    isolated=frozenset({Stage.SCENE}),
)
