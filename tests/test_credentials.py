"""Credentials on the disk: private, whole, readable by their process only, and out of use when they should be."""

from __future__ import annotations

import json
import os
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from processes import run_to_end

from deploy.credential_store import CredentialStore
from wire.access import principal
from wire.credentials import (
    Credential,
    Guests,
    check_for,
    credential_line,
    for_one_run,
    guests_line,
    read_credential,
    read_guests,
)
from wire.errors import CredentialError, Refused
from wire.private_files import new_folder, write_private

NAMES = ["sim", "router", "leader", "observer", "operator", "a1", "a2"]


@pytest.fixture
def store(tmp_path: Path) -> CredentialStore:
    return CredentialStore.create(tmp_path / "home", ["a1", "a2"], days=30, hosts=["sim.example", "10.0.0.7"])


def x509_of(store: CredentialStore, name: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((store.folder / name / "certificate.pem").read_bytes())


def logins(store: CredentialStore) -> list[str]:
    return [guest.who.login for guest in read_guests(store.folder / "sim").admitted]


# Files


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_files_are_0600_and_folders_0700_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        folder = CredentialStore.create(tmp_path / "home", ["a1"], days=1, hosts=[]).folder
    finally:
        os.umask(before)
    modes = {path: stat.S_IMODE(path.stat().st_mode) for path in [folder, *folder.rglob("*")]}
    assert {mode for path, mode in modes.items() if path.is_dir()} == {0o700}
    assert {mode for path, mode in modes.items() if path.is_file()} == {0o600}


def test_a_folder_holds_what_its_process_needs_and_no_secret_of_another(store: CredentialStore) -> None:
    files = {name: sorted(path.name for path in (store.folder / name).iterdir()) for name in NAMES}
    agent = ["authority.pem", "certificate.pem", "credential.json", "key.pem"]
    assert files == {name: agent for name in NAMES} | {"sim": sorted([*agent, "guests.json"])}
    texts = {name: "".join(p.read_text() for p in (store.folder / name).iterdir()) for name in NAMES}
    for name in NAMES:
        own = read_credential(store.folder / name)
        assert own.certificate is not None
        for other in set(NAMES) - {name}:
            assert own.certificate.key not in texts[other]
            assert own.password not in texts[other] or other == "sim"  # who has to know it
    assert {path.name for path in store.folder.iterdir()} == {*NAMES, "ca"}


def test_a_private_file_is_never_open_to_others_and_never_half_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []
    genuine = os.fsync

    def look(descriptor: int) -> None:
        seen.append(stat.S_IMODE(os.fstat(descriptor).st_mode))
        assert not (tmp_path / "secret").exists()
        genuine(descriptor)

    monkeypatch.setattr(os, "fsync", look)
    write_private(tmp_path / "secret", "text")
    assert seen == [0o600]

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CredentialError, match=r"secret: cannot be written \(No space left on device\)"):
        write_private(tmp_path / "secret", "longer text")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"secret": "text"}


def test_a_folder_that_fails_on_the_way_leaves_the_old_one(tmp_path: Path) -> None:
    with new_folder(tmp_path / "f") as building:
        (building / "x").write_text("old")
    with pytest.raises(FileNotFoundError), new_folder(tmp_path / "f") as building:
        (building / "no such folder" / "x").write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["f"]
    assert (tmp_path / "f" / "x").read_text() == "old"


@pytest.mark.parametrize("file", ["credential.json", "key.pem"])
def test_a_secret_that_others_may_read_is_not_used(store: CredentialStore, file: str) -> None:
    (store.folder / "a1" / file).chmod(0o640)
    with pytest.raises(CredentialError, match=r"mode 0640.*chmod 600"):
        read_credential(store.folder / "a1")


@pytest.mark.parametrize(
    "text", ["", "[]", "{", "null", '{"v": 2}', '{"v":1,"name":"a1","role":"king","login":"a1","password":"x"}']
)
def test_what_is_no_credential_is_said_in_one_sentence(store: CredentialStore, text: str) -> None:
    write_private(store.folder / "a1" / "credential.json", text)
    with pytest.raises(CredentialError, match=r"a1/credential\.json: "):
        read_credential(store.folder / "a1")


def test_a_login_cannot_smuggle_a_second_line_into_the_password_file(store: CredentialStore) -> None:
    fields = json.loads((store.folder / "sim" / "guests.json").read_text())
    fields[0]["login"] = "leader:x\nroot"
    write_private(store.folder / "sim" / "guests.json", json.dumps(fields))
    with pytest.raises(CredentialError, match="login"):
        read_guests(store.folder / "sim")


def test_the_folder_of_all_is_no_credential_and_names_those_in_it(store: CredentialStore) -> None:
    with pytest.raises(CredentialError, match="one of the folders in it: a1, a2, leader"):
        read_credential(store.folder)
    with pytest.raises(CredentialError, match="credential of an agent"):
        read_guests(store.folder / "a1")


# Certificates


def test_a_certificate_names_its_login_and_only_a_server_s_can_be_a_server_s(store: CredentialStore) -> None:
    for name in NAMES:
        certificate = x509_of(store, name)
        (common,) = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        assert common.value == name
        uses = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert (ExtendedKeyUsageOID.SERVER_AUTH in uses) == (name in ("sim", "router"))
        assert not certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    names = x509_of(store, "sim").extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["localhost", "sim.example"]
    assert [str(each) for each in names.get_values_for_type(x509.IPAddress)] == ["127.0.0.1", "::1", "10.0.0.7"]


def test_a_certificate_expires_when_its_credential_does(store: CredentialStore) -> None:
    (entry,) = [each for each in store.entries() if each.name == "a1"]
    assert x509_of(store, "a1").not_valid_after_utc == entry.until == read_credential(store.folder / "a1").expires
    assert timedelta(days=29) < entry.until - datetime.now(UTC) <= timedelta(days=30)


# Changes


def test_a_rotated_credential_has_a_new_login_password_and_key_and_the_old_login_is_gone(
    store: CredentialStore,
) -> None:
    old = store.credential("a1")
    store.rotate("a1", days=10)
    new = CredentialStore(store.folder).credential("a1")
    assert (old.who.login, new.who.login) == ("a1", "a1.2")
    assert old.password != new.password
    assert new.certificate is not None
    assert old.certificate is not None
    assert old.certificate.key != new.certificate.key
    assert sorted(logins(store)) == ["a1.2", "a2", "leader", "observer", "operator"]
    (common,) = x509_of(store, "a1").subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert common.value == "a1.2"


def test_a_revoked_credential_is_let_in_no_more_and_comes_back_only_under_a_new_login(store: CredentialStore) -> None:
    store.revoke("a1")
    assert "a1" not in logins(store)
    assert not (store.folder / "a1").exists()
    again = CredentialStore(store.folder)
    assert [entry.name for entry in again.entries() if entry.revoked] == ["a1"]
    assert again.add(["a1"], days=1) == []  # it has one: the revoked one
    again.rotate("a1", days=1)
    assert "a1.2" in logins(store)
    assert "a1" not in logins(store)


def test_an_expired_credential_is_told_by_its_own_process_and_forgotten_by_the_simulator(tmp_path: Path) -> None:
    long_ago = datetime.now(UTC) - timedelta(days=10)
    store = CredentialStore.create(tmp_path / "home", ["a1"], days=3, hosts=[], now=long_ago)
    with pytest.raises(CredentialError, match=r"a1 expired at .* --rotate a1"):
        check_for(store.credential("a1"), "a1")
    assert read_guests(store.folder / "sim").in_time(datetime.now(UTC)) == ()
    store.rotate("a1", days=3)
    check_for(store.credential("a1"), "a1")


def test_a_credential_of_another_is_told_before_anybody_is_asked(store: CredentialStore) -> None:
    with pytest.raises(CredentialError, match="this credential is for a2, not for a1"):
        check_for(store.credential("a2"), "a1")


def test_a_bad_name_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(Refused):
        CredentialStore.create(tmp_path / "home", ["a1", "a/2"], days=1, hosts=[])
    assert list(tmp_path.iterdir()) == []


# Over standard input


def test_credentials_of_one_run_survive_the_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    guests = for_one_run(["a1", "leader"])
    assert len({guests.own.password, *(guest.password for guest in guests.admitted)}) == 3

    def from_pipe(line: bytes, read: type[Credential] | type[Guests]) -> Credential | Guests:
        reading, writing = os.pipe()
        os.write(writing, line + b"what follows")
        os.close(writing)
        genuine = os.read
        with monkeypatch.context() as patch:
            patch.setattr(os, "read", lambda _, n: genuine(reading, n))
            found = read_credential("-") if read is Credential else read_guests("-")
        assert os.read(reading, 100) == b"what follows"  # not taken
        os.close(reading)
        return found

    assert from_pipe(guests_line(guests), Guests) == guests
    assert from_pipe(credential_line(guests.of("a1")), Credential) == guests.of("a1")


def test_a_credential_does_not_show_its_secrets_when_printed(store: CredentialStore) -> None:
    own = store.credential("a1")
    assert own.certificate is not None
    assert own.password not in repr(own)
    assert own.certificate.key not in repr((own, own.certificate))
    assert all(entry.password not in repr(entry) for entry in store.entries())
    assert own.who == principal("a1")


# The verb


def test_the_verb_makes_lists_renews_and_revokes(tmp_path: Path) -> None:
    def credentials(*arguments: str) -> str:
        ended = run_to_end("credentials", "team", *arguments, cwd=tmp_path)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    assert "sim, router, leader, observer, operator, a1, a2, b1" in credentials("--arms", "2", "--arm", "b1")
    credentials("--arm", "a3", "--days", "5")
    credentials("--revoke", "a2")
    credentials("--rotate", "a1")
    listed = credentials("--list")
    states = {line.split()[0]: line.split()[1] for line in listed.splitlines()}
    assert states == dict.fromkeys([*NAMES[:5], "a1", "a3", "b1"], "good") | {"a2": "revoked"}
    assert all(entry.fingerprint in listed for entry in CredentialStore(tmp_path / "team").entries())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["team"], "one thing at a time"),
        (["team", "--list", "--arms", "2"], "one thing at a time"),
        (["nobody", "--list"], "no credentials here"),
        (["team", "--arms", "1"], "a1: have one already"),
        (["team", "--rotate", "a9"], "a9: has no credential here"),
        (["team", "--revoke", "sim"], "revoking it would lock nobody out"),
        (["team", "--arm", "a/*"], "expected 1 to 40 of a-z"),
        (["team", "--arm", "ca"], "--arm ca: the authority's folder has this name"),
        (["new", "--arm", "ca"], "--arm ca: the authority's folder has this name"),
        (["team", "--arm", "a5", "--days", "0"], "expected 1 to 3650"),
        (["team", "--router-config", "r.json5"], "give its name with --run"),
        (["team", "--router-config", "r.json5", "--run", "x", "--listen", "tcp/0.0.0.0:7447"], "will not listen"),
        (["team", "--router-config", "other", "--run", "x"], "is a folder; expected the file to write"),
        (["team", "--router-config", "other/thesis.tex/r.json5", "--run", "x"], "cannot be written"),
        (["team", "--router-config", "r.json5", "--run", "x", "--listen", "foo"], "bad address 'foo'"),
        (["team", "--list", "--host", "sim.example"], "--host: means nothing beside what is asked for"),
        (["team", "--list", "--days", "3", "--run", "x"], "--days, --run: means nothing"),
        (["team", "--revoke", "a2"], "a2: is revoked already; --rotate a2 makes a new one"),
        (["other/thesis.tex/team", "--arms", "1"], "cannot be made"),
        (["new", "--arms", "1", "--host", "ü.example"], "--host 'ü.example': expected an IP address or a host name"),
        (["new", "--arms", "1", "--host", ""], "--host '': expected"),
        (["new", "--arms", "1", "--host", "a b c"], "--host 'a b c': expected"),
        (["other", "--arms", "1"], "holds no credentials of ours"),
    ],
)
def test_what_the_verb_cannot_do_is_one_sentence_and_status_2(tmp_path: Path, arguments: list[str], said: str) -> None:
    CredentialStore.create(tmp_path / "team", ["a1", "a2"], days=1, hosts=[]).revoke("a2")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("")
    before = sorted(path for path in tmp_path.rglob("*"))
    ended = run_to_end("credentials", *arguments, cwd=tmp_path)
    (line,) = ended.stderr.splitlines()
    assert said in line
    assert ended.returncode == 2
    assert sorted(path for path in tmp_path.rglob("*")) == before


def test_the_folder_where_one_stands_cannot_be_made_anew(tmp_path: Path) -> None:
    ended = run_to_end("credentials", ".", "--arms", "1", cwd=tmp_path)
    assert ended.stderr.splitlines() == ["palanquin: .: names no folder of its own; expected a name such as team"]
    assert ended.returncode == 2
    assert list(tmp_path.iterdir()) == []
