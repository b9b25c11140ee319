"""What the routes of one app share, and how they reach it."""

from dataclasses import dataclass
from typing import Annotated

import sqlalchemy as sa
from farfield.store.artifacts import Artifacts
from fastapi import Depends, Request

from farfield_api.key_use import KeyUse
from farfield_api.queue import Queue
from farfield_api.rates import RateLimits
from farfield_api.readiness import Readiness
from farfield_api.settings import ApiSettings
from farfield_api.streams import EventPoller


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    settings: ApiSettings
    engine: sa.Engine
    artifacts: Artifacts
    queue: Queue
    poller: EventPoller
    readiness: Readiness
    rates: RateLimits
    key_use: KeyUse


async def state_of(request: Request) -> State:
    """Return the state of the app. Asynchronous, so that no thread is asked for it."""
    found = request.app.state.farfield
    assert isinstance(found, State)
    return found


Service = Annotated[State, Depends(state_of)]
