"""What the operator's pages show: the workers, and what takes how much room."""

from typing import Any

from farfield.store import storage, workers
from fastapi import APIRouter

from farfield_api.auth import Operator
from farfield_api.errors import RESPONSES
from farfield_api.state import Service
from farfield_api.times import iso

router = APIRouter(prefix="/v1", tags=["operations"], responses=RESPONSES)


@router.get("/workers", summary="Who computes: queues, capability, current shard, last heartbeat, throughput, failures")
def list_workers(caller: Operator, service: Service) -> dict[str, Any]:
    listed = [
        {**told, "started_at": iso(told["started_at"]), "heartbeat_at": iso(told["heartbeat_at"])}
        for told in workers.listed(service.engine)
    ]
    return {"workers": listed, "queues": workers.served_queues(service.engine)}


@router.get("/storage", summary="Artifacts by kind, those that nothing refers to, and each tenant against its quota")
def show_storage(caller: Operator, service: Service) -> dict[str, Any]:
    kinds = storage.by_kind(service.engine)
    total = {key: sum(kind[key] for kind in kinds.values()) for key in ("artifacts", "bytes")}
    return {"kinds": kinds, "total": total, "tenants": storage.by_tenant(service.engine)}
