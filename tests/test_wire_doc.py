"""docs/wire.md says what wire/ does: every message, field, limit, key, reason and byte."""

from __future__ import annotations

import json
import queue
import re
import time
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgpack
import pytest
import zenoh

from sim_server.reception import Reception, Terms
from wire import PROTOCOL_VERSION, codec, zenoh_link
from wire.access import TABLE, Role, principal
from wire.codec import SCHEMAS, decode, decode_any, encode
from wire.credentials import Certificate, Credential
from wire.errors import Reason, Refused
from wire.keys import ANY_HELLO, Keys
from wire.lifecycle import Invitation
from wire.messages import MAX_INT, MAX_JOINTS, Command, End, State, Vector, Welcome
from wire.zenoh_config import client_config

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "wire.md").read_text(encoding="utf-8")
FOLLOWER_NEEDS = {"hello", "welcome", "state", "command", "refusal", "end"}


@dataclass(frozen=True)
class Field:
    """A row of a message's table."""

    name: str
    type: str
    shape: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Example:
    """A message as values and as bytes."""

    name: str
    size: int
    values: dict[str, Any]
    payload: bytes


def rows(text: str) -> list[list[str]]:
    """The first table in the text, without its head."""
    lines: list[str] = []
    for line in text.splitlines():
        if line.startswith("|"):
            lines.append(line)
        elif lines:
            break
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def code(cell: str) -> list[str]:
    """What stands in backquotes."""
    return re.findall(r"`([^`]+)`", cell)


def marked(mark: str) -> str:
    """The page from an invisible mark on."""
    assert PAGE.count(f"<!-- {mark} -->") == 1
    return PAGE.partition(f"<!-- {mark} -->")[2]


MESSAGES = {
    name: [Field(code(row[0])[0], *row[1:]) for row in rows(body)]
    for name, body in re.findall(r"^### `(\w+)`\n(.*?)(?=^##)", PAGE, re.MULTILINE | re.DOTALL)
}
FIELDS = [(name, field) for name, fields in MESSAGES.items() for field in fields]
every_field = pytest.mark.parametrize(("kind", "field"), FIELDS, ids=[f"{name}.{field.name}" for name, field in FIELDS])
EXAMPLES = [
    Example(name, int(size), json.loads(values), bytes.fromhex(payload))
    for name, size, values, payload in re.findall(
        r"^### Example: `(\w+)` \((\d+) bytes\)\n+```json\n(.*?)```\n+```text\n(.*?)```", PAGE, re.MULTILINE | re.DOTALL
    )
]
CONFIGURATION = json.loads(marked("configuration").partition("```json\n")[2].partition("```")[0])

# Messages


def test_every_message_has_its_table_and_no_other() -> None:
    assert list(MESSAGES) == list(SCHEMAS)


@pytest.mark.parametrize("kind", SCHEMAS)
def test_a_table_has_every_field_in_order_and_no_other(kind: str) -> None:
    assert [field.name for field in MESSAGES[kind]] == list(SCHEMAS[kind][1])


TYPES = {int: "integer", float: "number", str: "text", bytes: "bytes", Vector: "numbers", dict[str, Vector]: "points"}


@every_field
def test_a_field_has_the_type_that_is_written(kind: str, field: Field) -> None:
    hint = get_type_hints(SCHEMAS[kind][0])[field.name]
    if get_origin(hint) is Literal:
        assert (field.type, code(field.shape)) == ("choice", list(get_args(hint)))
    else:
        assert field.type == TYPES[hint]


def reason_for(kind: str, name: str, value: object) -> Reason | None:
    """Why the codec refuses the value in this field; None if it takes it. The fields before it are right."""
    body: dict[str, object] = {"v": PROTOCOL_VERSION, "type": kind}
    for field in MESSAGES[kind]:
        body[field.name] = GOOD[field.type] if field.type != "choice" else code(field.shape)[0]
        if field.type == "numbers":
            body[field.name] = [0.0] * (1 if field.shape == "(n,)" else int(field.shape[1:-2]))
    body[name] = value
    try:
        decode_any(msgpack.packb(body))
    except Refused as refused:
        return refused.reason
    return None


GOOD: dict[str, object] = {"bytes": b"", "integer": 0, "number": 0.0, "text": "", "points": {}, "numbers": []}


@every_field
def test_a_field_has_the_shape_and_the_limit_that_are_written(kind: str, field: Field) -> None:
    def reason(value: object) -> Reason | None:
        return reason_for(kind, field.name, value)

    match field.type:
        case "integer":
            assert (reason(0), reason(MAX_INT)) == (None, None)
            assert (reason(-1), reason(MAX_INT + 1)) == (Reason.RANGE, Reason.RANGE)
        case "number":
            assert (reason(-0.5), reason(2)) == (None, None)
        case "text":
            longest = int(field.shape)
            assert (reason("ä" * longest), reason("ä" * (longest + 1))) == (None, Reason.LENGTH)
        case "bytes":
            assert (reason(bytes(8)), reason(bytes(7)), reason("")) == (None, Reason.LENGTH, Reason.FIELD_TYPE)
        case "choice":
            assert [reason(word) for word in code(field.shape)] == [None] * len(code(field.shape))
            assert reason("anything else") == Reason.RANGE
        case "points":
            assert (reason({"p" * 40: [0.0] * 3}), reason({"p" * 41: [0.0] * 3})) == (None, Reason.LENGTH)
            assert (reason({"p": [0.0] * 2}), reason({"p": [0.0] * 4})) == (Reason.LENGTH, Reason.LENGTH)
        case _:
            length = re.fullmatch(r"\((n|\d+),\)", field.shape)
            assert length is not None
            least, most = (1, MAX_JOINTS) if length[1] == "n" else (int(length[1]), int(length[1]))
            assert (reason([0.0] * least), reason([0.0] * most)) == (None, None)
            assert (reason([0.0] * (least - 1)), reason([0.0] * (most + 1))) == (Reason.LENGTH, Reason.LENGTH)


UNITS_IN_NAMES = {"_ns": "ns", "_s": "s", "_m": "m", "_deg": "degrees"}


@every_field
def test_a_unit_in_a_name_is_the_unit_in_the_table(kind: str, field: Field) -> None:
    for ending, unit in UNITS_IN_NAMES.items():
        if field.name.endswith(ending):
            assert field.unit == unit


@every_field
def test_physical_numbers_have_a_unit_and_every_field_a_meaning(kind: str, field: Field) -> None:
    dimensionless = {"quat_wxyz", "real_time_factor"}
    if field.type in ("number", "numbers", "points"):
        assert bool(field.unit) == (field.name not in dimensionless)
    assert field.meaning


# Reasons, limits, keys, configuration


def test_every_reason_is_explained_and_no_other() -> None:
    table = rows(marked("reasons"))
    assert [code(reason) for reason, _ in table] == [[reason] for reason in Reason]
    assert all(when for _, when in table)


def test_the_limits_are_those_of_the_codec() -> None:
    table = rows(marked("limits"))
    named = {code(what)[0]: int(value) for what, value, _ in table if code(what)}
    assert named == {name: getattr(codec, name) for name in ("PROTOCOL_VERSION", "MAX_BYTES", "MAX_JOINTS", "MAX_INT")}
    ((entries, reason),) = [(int(value), code(reason)[0]) for what, value, reason in table if not code(what)]
    points: dict[str, Vector] = {str(k): (0.0, 0.0, 0.0) for k in range(entries + 1)}
    with pytest.raises(Refused) as refused:
        decode_any(encode(Welcome(1, "lock-step", 1, points, 0.0, 0.0, (0.0,) * 7)))
    assert refused.value.reason == reason
    del points["0"]
    decode_any(encode(Welcome(1, "lock-step", 1, points, 0.0, 0.0, (0.0,) * 7)))


def test_the_keys_are_those_of_the_code() -> None:
    keys = Keys("my-run")
    arm, leader = keys.arm("a1"), keys.leader
    table = rows(marked("keys"))
    written = [code(row[0])[0].replace("<run>", "my-run").replace("<arm>", "a1") for row in table]
    assert written == [
        *(arm.state, arm.command, arm.hello, arm.alive),
        *(leader.state, leader.command, leader.hello, leader.alive),
        *(keys.sim_alive, keys.progress, keys.rows, keys.events, keys.deeds, keys.order),
    ]
    for expression in ANY_HELLO:
        assert f"`{expression}`" in PAGE


def test_every_message_travels_on_some_key() -> None:
    assert {name for row in rows(marked("keys")) for name in code(row[4])} == set(SCHEMAS)


def test_the_written_configuration_is_the_one_that_our_agents_use() -> None:
    ours: dict[str, Any] = {}

    def note(config: dict[str, Any], endpoint: str) -> None:
        ours.update(config)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zenoh_link, "_open", note)
        zenoh_link.open_client("tcp/127.0.0.1:7447")
    assert ours == CONFIGURATION


def test_the_written_rights_are_the_table_s() -> None:
    written = [
        (row[0], tuple(code(row[1])), code(row[2])[0].replace("<run>", "{run}").replace("<arm>", "{arm}"))
        for row in rows(marked("rights"))
    ]
    assert written == [(row.flow, row.messages, row.key) for row in TABLE if row.role is Role.FOLLOWER]


def test_the_written_login_is_what_our_agents_add_to_it() -> None:
    """With a password word for word; with a certificate its content in base64 instead of the paths."""
    with_password = client_config("tcp/127.0.0.1:7447", Credential(principal("a1"), "..."))
    added = with_password["transport"].pop("auth")
    assert with_password == CONFIGURATION
    assert {"transport": {"auth": added}} == json.loads(
        marked("password").partition("```json\n")[2].partition("```")[0]
    )
    own = Credential(principal("a1"), "", None, Certificate("authority", "certificate", "key"))
    tls = client_config("tls/127.0.0.1:7447", own)["transport"]["link"]["tls"]
    written = json.loads(marked("certificate").partition("```json\n")[2].partition("```")[0])
    assert {key.removesuffix("_base64") for key in tls} == set(written["transport"]["link"]["tls"])


# Examples


def test_there_is_an_example_of_all_that_a_follower_sends_and_gets() -> None:
    assert {example.name for example in EXAMPLES} == FOLLOWER_NEEDS
    assert len(EXAMPLES) == PAGE.count("### Example:")


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_an_example_s_bytes_are_its_values(example: Example) -> None:
    message = decode_any(example.payload)
    assert type(message) is SCHEMAS[example.name][0]
    # as text: 1 and 1.0 are two things on the wire, and the order counts
    assert json.dumps(msgpack.unpackb(example.payload)) == json.dumps(example.values)
    for name in SCHEMAS[example.name][1]:
        assert json.dumps(getattr(message, name)) == json.dumps(example.values[name])


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_an_example_s_bytes_are_what_our_side_sends(example: Example) -> None:
    assert encode(decode_any(example.payload)) == example.payload
    assert len(example.payload) == example.size


def test_the_refusal_in_the_example_has_a_reason_of_ours() -> None:
    (refusal,) = [example.values for example in EXAMPLES if example.name == "refusal"]
    assert refusal["text"].startswith(f"{Reason(refusal['reason'])}: ")


# The page is enough

PATIENCE_S = 10.0


def follower_from_the_page(endpoint: str, values: dict[str, dict[str, Any]], life: list[str]) -> None:
    """Steps 1 to 9 of "A follower's life" with Zenoh and MessagePack only; the messages are the page's examples."""
    configuration = CONFIGURATION | {"connect": CONFIGURATION["connect"] | {"endpoints": [endpoint]}}
    base = "palanquin/transport/arm/a1"
    inbox: queue.Queue[bytes] = queue.Queue()
    with zenoh.open(zenoh.Config.from_json5(json.dumps(configuration))) as session:

        def hand_over(sample: zenoh.Sample) -> None:
            inbox.put(sample.payload.to_bytes())

        kept: list[Any] = []
        kept.append(session.declare_subscriber(f"{base}/state", zenoh.handlers.Callback(hand_over, indirect=False)))
        publisher: Any = session.declare_publisher(
            f"{base}/command", congestion_control=zenoh.CongestionControl.DROP, express=True
        )
        (reply,) = session.get(f"{base}/hello", payload=msgpack.packb(values["hello"]), timeout=PATIENCE_S)
        assert reply.ok is not None
        welcome = msgpack.unpackb(reply.ok.payload.to_bytes())
        life.append(welcome["type"])
        kept.append(session.liveliness().declare_token(f"{base}/alive"))
        deadline = time.monotonic() + PATIENCE_S
        while not publisher.matching_status.matching:
            assert time.monotonic() < deadline
            time.sleep(0.002)
        while True:
            message = msgpack.unpackb(inbox.get(timeout=PATIENCE_S))
            life.append(message["type"])
            if message["type"] == "end":
                break
            answer = values["command"] | {"tick": message["tick"], "lease": welcome["lease"]}
            publisher.put(msgpack.packb(answer))
        for declared in kept:
            declared.undeclare()


@pytest.mark.system
def test_a_follower_written_from_this_page_alone_is_let_in_and_obeyed() -> None:
    values = {example.name: example.values for example in EXAMPLES}
    hello = values["hello"]
    invitation = Invitation("transport", "follower", "a1", hello["arm_model"], hello["digest"], 7, lost_after=20)
    state = decode(next(example.payload for example in EXAMPLES if example.name == "state"), State)
    endpoint = zenoh_link.free_endpoint()
    life: list[str] = []
    events: list[str] = []
    with zenoh_link.open_server(endpoint) as link:
        terms = Terms("lock-step", 1_000_000, {}, 0.0)
        reception = Reception(link, Keys("transport"), [(invitation, terms)], lambda kind, **_: events.append(kind))
        agent = reception.agents["a1"]
        thread = Thread(target=follower_from_the_page, args=(endpoint, values, life), daemon=True)
        thread.start()
        arrived = reception.inbox.get(timeout=PATIENCE_S)
        assert arrived.question is not None
        reception.answer(arrived.question)
        assert reception.inbox.get(timeout=PATIENCE_S).kind == "alive"
        while not agent.is_in:
            reception.match()
            thread.join(0.002)
            assert thread.is_alive()
        agent.link.state_sent(state.tick)
        agent.publisher.put(encode(state))
        agent.link.answer(decode(reception.inbox.get(timeout=PATIENCE_S).payload, Command))
        agent.publisher.put(encode(End("over", "the run is over")))
        assert reception.inbox.get(timeout=PATIENCE_S).kind == "gone"
        thread.join(PATIENCE_S)
    assert life == ["welcome", "state", "end"]
    assert events == ["joined"]
