"""What the compose files and the manifest promise, read from them: who shares a network with whom, what each may."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import typer
import yaml

from deploy.cli import app
from deploy.docker_engine import AGENT_LABEL, RUN_LABEL

DEPLOY = Path(__file__).resolve().parent.parent / "deploy"
FOUR, EIGHT = ("compose.yaml",), ("compose.yaml", "compose.eight.yaml")
CHAOS = ("compose.yaml", "compose.chaos.yaml")
OLDEST_KUBERNETES = "1.31"
"""Of which the manifest says that it will do: `ordinals` and the label `pod-index` are stable there."""

Fields = dict[str, Any]


def merged(files: tuple[str, ...]) -> Fields:
    """The services and networks of several compose files, as Compose merges them: networks and ports add up."""
    whole: Fields = {"services": {}, "networks": {}}
    for file in files:
        content = yaml.safe_load((DEPLOY / file).read_text(encoding="utf-8"))
        whole["networks"] |= content["networks"]
        for name, service in content["services"].items():
            before = whole["services"].get(name, {})
            networks = [*before.get("networks", []), *service["networks"]]
            whole["services"][name] = {**before, **service, "networks": networks}
    return whole


def agents(compose: Fields) -> dict[str, Fields]:
    return {name: service for name, service in compose["services"].items() if name != "sim"}


def words(command: str) -> list[str]:
    """A service's command as Compose hands it over, with the defaults of its variables."""
    return shlex.split(re.sub(r"\$\{[A-Z_]+:-([^}]*)\}", r"\1", command))


@pytest.mark.parametrize("files", [FOUR, EIGHT, CHAOS])
def test_no_two_agents_share_a_network_and_each_shares_one_with_the_simulator(files: tuple[str, ...]) -> None:
    compose = merged(files)
    networks = {name: set(service["networks"]) for name, service in agents(compose).items()}
    assert all(len(its) == 1 for its in networks.values())
    assert [pair for pair in combinations(networks, 2) if networks[pair[0]] & networks[pair[1]]] == []
    assert set().union(*networks.values()) <= set(compose["services"]["sim"]["networks"])
    assert all("network_mode" not in service for service in compose["services"].values())


@pytest.mark.parametrize("files", [FOUR, EIGHT, CHAOS])
def test_no_agent_s_network_leads_out(files: tuple[str, ...]) -> None:
    compose = merged(files)
    for service in agents(compose).values():
        (network,) = service["networks"]
        assert compose["networks"][network]["internal"] is True
        assert "ports" not in service
    for port in compose["services"]["sim"].get("ports", []):
        assert port.startswith("127.0.0.1:")


@pytest.mark.parametrize("files", [FOUR, EIGHT])
def test_nobody_is_root_has_a_capability_or_may_write_its_image(files: tuple[str, ...]) -> None:
    for name, service in merged(files)["services"].items():
        assert service["user"] == "${PALANQUIN_USER:-1000:1000}", name
        assert service["read_only"] is True, name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert "privileged" not in service, name
        assert "cap_add" not in service, name


@pytest.mark.parametrize("files", [FOUR, EIGHT])
def test_everybody_has_its_own_credential_and_nobody_else_s(files: tuple[str, ...]) -> None:
    for name, service in merged(files)["services"].items():
        (credential, *others) = service["volumes"]
        assert credential["source"] == "${PALANQUIN_TEAM:-../team}/" + name
        assert credential["read_only"] is True
        assert [other["target"] for other in others] == (["/work/runs"] if name == "sim" else [])


@pytest.mark.parametrize("files", [FOUR, EIGHT])
def test_every_agent_is_the_one_that_its_label_says(files: tuple[str, ...]) -> None:
    """The labels are what a deed finds its container by: a wrong one would kill somebody else."""
    for name, service in merged(files)["services"].items():
        command = words(service["command"])
        run = command[command.index("--run") + 1]
        assert service["labels"] == {RUN_LABEL: run, AGENT_LABEL: name}
        if command[0] == "follower":
            assert command[command.index("--arm") + 1] == name
        else:
            assert command[0] == name


def test_four_and_eight_have_as_many_followers() -> None:
    for files, count in ((FOUR, 4), (EIGHT, 8)):
        followers = [name for name, each in agents(merged(files)).items() if words(each["command"])[0] == "follower"]
        assert followers == sorted(f"a{k}" for k in range(1, count + 1))


def documents() -> list[Fields]:
    return list(yaml.safe_load_all((DEPLOY / "kubernetes.yaml").read_text(encoding="utf-8")))


def of_kind(kind: str) -> dict[str, Fields]:
    return {each["metadata"]["name"]: each["spec"] for each in documents() if each["kind"] == kind}


def pods() -> Iterator[tuple[str, Fields]]:
    for kind in ("Deployment", "StatefulSet", "Job"):
        for name, spec in of_kind(kind).items():
            yield name, spec["template"]


@pytest.mark.parametrize("version", [OLDEST_KUBERNETES, kubernetes_validate.latest_version()])
def test_the_manifest_fits_the_schemas_of_kubernetes(version: str) -> None:
    for document in documents():
        kubernetes_validate.validate(document, version, strict=True)


def test_the_validator_sees_a_field_that_is_not_one() -> None:
    document = next(each for each in documents() if each["kind"] == "StatefulSet")
    document["spec"]["template"]["spec"]["containers"][0]["readonly"] = True
    with pytest.raises(kubernetes_validate.ValidationError, match="readonly"):
        kubernetes_validate.validate(document, OLDEST_KUBERNETES, strict=True)


def test_every_follower_has_a_policy_of_its_own_that_lets_it_reach_the_router_alone() -> None:
    policies = of_kind("NetworkPolicy")
    assert policies["nobody"] == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}
    follower = of_kind("StatefulSet")["follower"]
    first = follower["ordinals"]["start"]
    for k in range(first, first + follower["replicas"]):
        policy = policies[f"a{k}"]
        pod = {"statefulset.kubernetes.io/pod-name": f"follower-{k}"}
        assert policy["podSelector"] == {"matchLabels": pod}
        assert policy["policyTypes"] == ["Ingress", "Egress"]
        assert "ingress" not in policy
        router, names = policy["egress"]
        assert router == {
            "to": [{"podSelector": {"matchLabels": {"app": "router"}}}],
            "ports": [{"protocol": "TCP", "port": 7447}],
        }
        assert names["ports"] == [{"protocol": "UDP", "port": 53}]
        assert names["to"][0]["podSelector"] == {"matchLabels": {"k8s-app": "kube-dns"}}


def test_no_pod_is_root_has_a_capability_or_may_write_its_image() -> None:
    for name, template in pods():
        pod = template["spec"]
        assert pod["securityContext"]["runAsNonRoot"] is True, name
        assert pod["automountServiceAccountToken"] is False, name
        for container in (*pod["containers"], *pod["initContainers"]):
            assert container["securityContext"] == {
                "allowPrivilegeEscalation": False,
                "readOnlyRootFilesystem": True,
                "capabilities": {"drop": ["ALL"]},
            }, name


def commands() -> dict[str, list[str]]:
    found = {name: words(service["command"]) for name, service in merged(EIGHT)["services"].items()}
    for name, template in pods():
        (container,) = template["spec"]["containers"]
        found[f"pod {name}"] = [word.replace("$(ARM)", "a1") for word in container["args"]]
    return found


@pytest.mark.parametrize("name", commands())
def test_every_command_is_one_that_palanquin_understands(name: str) -> None:
    """Parsed, not done: an option that is not there any more ends in an error."""
    verb, *arguments = commands()[name]
    command: Any = typer.main.get_command(app)
    parsed = command.commands[verb].make_context(verb, arguments).params
    assert parsed.get("run", "carry") == "carry"
