"""Deliveries: written with their event, signed, tried again, never led inside, and not lost with who sends them."""

import base64
import http.server
import ipaddress
import json
import socket
import threading
import time

import pytest
import sqlalchemy as sa
from farfield import webhooks as rules
from farfield.errors import ServiceError, SignatureInvalid, WebhookAddressRefused
from farfield.store import jobs, sealed, webhooks
from farfield.store.engine import now, read, write
from farfield.store.tables import webhook, webhook_delivery
from farfield_workers.webhooks import Postman, post

HERE = rules.networks("127.0.0.0/8")
KEY = "5a" * 32


class Receiver(http.server.BaseHTTPRequestHandler):
    def do_POST(self):
        body = self.rfile.read(int(self.headers["content-length"]))
        self.server.got.append((self.path, dict(self.headers), body))
        status = self.server.answers.pop(0) if self.server.answers else 204
        self.send_response(status)
        if status == 302:
            self.send_header("location", "/elsewhere")
        self.end_headers()

    def log_message(self, *args):
        pass


@pytest.fixture
def receiver():
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Receiver)
    server.got, server.answers = [], []
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
    server.url = f"http://127.0.0.1:{server.server_port}/hook?from=farfield"
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture
def hook(bench, receiver):
    """(id, secret) of a webhook for every job."""
    return webhooks.create(
        bench.engine, bench.tenant_id, name="test", url=receiver.url, events=("queued", "cancelled"), every_job=True
    )


@pytest.fixture
def postman(bench):
    return Postman(bench.engine, HERE)


def rows(bench):
    with read(bench.engine) as tx:
        return tx.execute(sa.select(webhook_delivery).order_by(webhook_delivery.c.created_at)).all()


def make_due(bench):
    with write(bench.engine) as tx:
        tx.execute(sa.update(webhook_delivery).where(webhook_delivery.c.state == "pending").values(next_at=now()))


def send(postman):
    """Begin what is due, wait for it, and return how many deliveries that were."""
    number = postman.round()
    postman.wait()
    return number


def test_a_job_is_told_of_once_and_the_receiver_can_verify_it(bench, receiver, hook, postman):
    job, _ = bench.submit()
    jobs.cancel(bench.engine, bench.tenant_id, job)
    assert send(postman) == 2
    assert send(postman) == 0
    told = {json.loads(body)["type"]: (headers, body) for _, headers, body in receiver.got}
    assert set(told) == {"job.queued", "job.cancelled"}
    headers, body = told["job.cancelled"]
    rules.verify(hook[1], headers, body)
    data = json.loads(body)["data"]
    assert (data["job"], data["state"], data["seq"]) == (job, "cancelled", 2)
    assert receiver.got[0][0] == "/hook?from=farfield"
    for wrong in (body + b" ", b""):
        with pytest.raises(SignatureInvalid):
            rules.verify(hook[1], headers, wrong)
    with pytest.raises(SignatureInvalid):
        rules.verify(rules.new_secret(), headers, body)
    with pytest.raises(SignatureInvalid):
        rules.verify(hook[1], headers, body, now=time.time() + 301)
    assert [row.state for row in rows(bench)] == ["delivered", "delivered"]


def test_a_delivery_is_written_with_its_event_or_not_at_all(bench, hook):
    from farfield.store import events

    job, _ = bench.submit()
    with pytest.raises(RuntimeError), write(bench.engine) as tx:
        events.append(tx, job, "job", {"state": "cancelled"})
        raise RuntimeError("killed")
    assert [(row.event, row.seq) for row in rows(bench)] == [("job.queued", 1)]


def test_a_webhook_hears_of_what_it_asked_for(bench, receiver, postman):
    def create(tenant_id, events, every_job):
        return webhooks.create(bench.engine, tenant_id, name="n", url=receiver.url, events=events, every_job=every_job)[
            0
        ]

    from farfield.store import tenants

    create(bench.tenant_id, ("done",), True)
    named = create(bench.tenant_id, ("queued",), False)
    create(tenants.create_tenant(bench.engine, "other"), ("queued",), True)
    paused = create(bench.tenant_id, ("queued",), True)
    webhooks.change(bench.engine, bench.tenant_id, paused, {"active": False})
    bench.submit()
    assert rows(bench) == []
    bench.submit(budget="300 calls", webhook_id=named)
    assert [row.webhook_id for row in rows(bench)] == [named]


def test_a_failed_delivery_is_tried_again_later_with_the_same_bytes(bench, receiver, hook, postman):
    receiver.answers += [500, 302]
    bench.submit()
    for attempt, status in ((1, 500), (2, 302)):
        assert send(postman) == 1
        (row,) = rows(bench)
        assert (row.state, row.attempt, row.status) == ("pending", attempt, status)
        with read(bench.engine) as tx:
            wait = row.next_at - tx.scalar(sa.select(now()))
        assert wait == pytest.approx(webhooks.BACKOFF_S[attempt - 1], abs=2.0)
        assert send(postman) == 0
        make_due(bench)
    assert send(postman) == 1
    assert rows(bench)[0].state == "delivered"
    assert {path for path, _, _ in receiver.got} == {"/hook?from=farfield"}  # the redirect was not followed
    assert len({(headers["webhook-id"], body) for _, headers, body in receiver.got}) == 1


def test_after_its_last_attempt_a_delivery_has_failed_and_can_be_asked_for_again(bench, receiver, hook, postman):
    receiver.answers += [500] * 10
    bench.submit()
    for _ in range(len(webhooks.BACKOFF_S) + 1):
        make_due(bench)
        assert send(postman) == 1
    make_due(bench)
    assert send(postman) == 0
    (row,) = rows(bench)
    assert (row.state, row.attempt) == ("failed", 10)
    webhooks.redeliver(bench.engine, bench.tenant_id, hook[0], row.id)
    assert send(postman) == 1
    assert rows(bench)[0].state == "delivered"


def test_a_sender_that_is_killed_loses_no_delivery(bench, receiver, hook, postman):
    bench.submit()
    held = webhooks.claim(bench.engine, lease_s=0.2)
    assert held is not None
    assert webhooks.claim(bench.engine) is None
    time.sleep(0.25)
    assert send(postman) == 1
    assert rows(bench)[0].state == "delivered"
    webhooks.finish(bench.engine, held, status=None, error="it came back to life")
    assert rows(bench)[0].state == "delivered"


def test_who_is_gone_is_told_no_more(bench, receiver, hook, postman):
    receiver.answers += [410]
    bench.submit()
    send(postman)
    assert rows(bench)[0].state == "failed"
    assert not webhooks.get(bench.engine, bench.tenant_id, hook[0]).active


def test_for_a_day_the_old_secret_signs_too(bench, receiver, hook, postman):
    fresh = webhooks.rotate(bench.engine, bench.tenant_id, hook[0])
    bench.submit()
    send(postman)
    for secret in (hook[1], fresh):
        rules.verify(secret, receiver.got[0][1], receiver.got[0][2])


def test_an_address_that_became_private_gets_nothing(bench, receiver, hook, monkeypatch):
    bench.submit()
    send(Postman(bench.engine, ()))  # what was allowed at registration is so no more
    assert receiver.got == []
    (row,) = rows(bench)
    assert (row.state, row.status, row.error) == ("pending", None, "127.0.0.1 does not resolve to public addresses")
    assert row.next_at is not None


def test_the_connection_goes_to_the_address_that_was_looked_at(bench, receiver, hook, monkeypatch):
    bench.submit()
    due = webhooks.claim(bench.engine)
    asked = []
    real = socket.getaddrinfo
    monkeypatch.setattr(socket, "getaddrinfo", lambda host, *more, **kw: asked.append(host) or real(host, *more, **kw))
    to = rules.Endpoint(False, "rebinding.example", receiver.server_port, "/pinned", ("127.0.0.1",))
    assert post(to, due, None) == 204
    assert receiver.got[0][0] == "/pinned"
    assert receiver.got[0][1]["host"] == f"rebinding.example:{receiver.server_port}"
    assert "rebinding.example" not in asked


def test_a_byte_now_and_then_buys_no_time(bench, monkeypatch):
    monkeypatch.setattr("farfield_workers.webhooks.DEADLINE_S", 0.4)
    listening = socket.create_server(("127.0.0.1", 0))

    def drip():
        line, _ = listening.accept()
        try:
            for byte in b"HTTP/1.1 200 OK\r\nx-slow: " + b"y" * 200:
                line.send(bytes([byte]))
                time.sleep(0.02)
        except OSError:
            pass

    threading.Thread(target=drip, daemon=True).start()
    url = f"http://127.0.0.1:{listening.getsockname()[1]}/"
    webhooks.create(bench.engine, bench.tenant_id, name="slow", url=url, events=("queued",), every_job=True)
    bench.submit()
    started = time.monotonic()
    send(Postman(bench.engine, HERE))
    assert time.monotonic() - started < 2.0
    assert rows(bench)[0].error == "there was no answer within 0 s"
    listening.close()


def test_one_receiver_takes_two_threads_at_most(bench, monkeypatch):
    listening = socket.create_server(("127.0.0.1", 0))  # answers nothing
    monkeypatch.setattr("farfield_workers.webhooks.DEADLINE_S", 0.5)
    url = f"http://127.0.0.1:{listening.getsockname()[1]}/"
    webhooks.create(bench.engine, bench.tenant_id, name="mute", url=url, events=("queued",), every_job=True)
    for _ in range(4):
        bench.submit()
    postman = Postman(bench.engine, HERE)
    assert postman.round() == 2
    postman.wait()
    listening.close()


@pytest.mark.parametrize(
    "url",
    ["https://127.0.0.1/", "https://[::1]/", "https://2130706433/", "https://0x7f.1/", "https://10.0.0.1/",
     "https://169.254.169.254/latest/meta-data", "https://[::ffff:10.0.0.1]/", "https://[fe80::1]/", "http://8.8.8.8/",
     "https://user:secret@8.8.8.8/", "https://8.8.8.8/#part", "ftp://8.8.8.8/", "https:///none", "https://8.8.8.8:0/",
     "https://8.8.8.8\\@127.0.0.1/", "https://8.8.8.8/ x", "https://8.8.8.8:99999/", "https://[", "https://localhost/",
     "file:///etc/passwd", "https://0.0.0.0/", "https://224.0.0.1/"],
)  # fmt: skip
def test_addresses_that_no_webhook_may_have(url):
    with pytest.raises(WebhookAddressRefused):
        rules.resolve(url)


def test_a_public_address_is_taken_as_it_is():
    found = rules.resolve("https://8.8.8.8:8443/a?b=c")
    assert found == rules.Endpoint(True, "8.8.8.8", 8443, "/a?b=c", ("8.8.8.8",))
    assert rules.resolve("https://[2606:4700::1111]/").addresses == ("2606:4700::1111",)


def test_a_name_that_has_one_private_address_is_refused(monkeypatch):
    def mixed(host, port, **more):
        return [(2, 1, 6, "", (address, port)) for address in ("8.8.8.8", "192.168.1.5")]

    monkeypatch.setattr(socket, "getaddrinfo", mixed)
    with pytest.raises(WebhookAddressRefused):
        rules.resolve("https://mixed.example/")
    assert rules.resolve("https://mixed.example/", rules.networks("192.168.0.0/16")).addresses


# What the registries of special addresses hold (RFC 6890 and its heirs), apart from how the code asks.
SPECIAL = [
    ipaddress.ip_network(n)
    for n in ("0.0.0.0/8", "10.0.0.0/8", "100.64.0.0/10", "127.0.0.0/8", "169.254.0.0/16", "172.16.0.0/12",
              "192.0.0.0/24", "192.168.0.0/16", "198.18.0.0/15", "224.0.0.0/4", "240.0.0.0/4", "::/128", "::1/128", "fc00::/7",
              "fe80::/10", "fec0::/10", "ff00::/8")
]  # fmt: skip


def test_nothing_special_is_public_however_it_is_wrapped():
    import random

    rng = random.Random(5)
    for network in SPECIAL:
        for _ in range(200):
            address = network[rng.randrange(network.num_addresses)]
            assert not rules.is_public(address), address
            if address.version == 4:
                for wrapped in (
                    0xFFFF << 32 | int(address),
                    0x2002 << 112 | int(address) << 80,
                    0x64FF9B << 96 | int(address),
                    int(address),
                ):
                    assert not rules.is_public(ipaddress.IPv6Address(wrapped)), (address, hex(wrapped))  # fmt: skip


def stored(bench):
    with read(bench.engine) as tx:
        return tx.execute(sa.select(webhook.c.secret, webhook.c.old_secret)).one()


def kept_plain(secret):
    """What of the secret would give it away: its text, or its bytes in another alphabet."""
    return {secret, secret.removeprefix(rules.PREFIX), base64.b64decode(secret.removeprefix(rules.PREFIX)).hex()}


def test_secrets_are_sealed_in_the_database_and_sign_as_before(bench, receiver):
    facts = {"name": "n", "url": receiver.url, "events": ("queued",), "every_job": True}
    hook_id, first = webhooks.create(bench.engine, bench.tenant_id, **facts, key=KEY)
    fresh = webhooks.rotate(bench.engine, bench.tenant_id, hook_id, key=KEY)
    for text, secret in zip(stored(bench), (fresh, first), strict=True):
        assert text.startswith(sealed.SEALED) and not any(part in text for part in kept_plain(secret))
        assert sealed.unseal(KEY, text) == secret
    bench.submit()
    assert send(Postman(bench.engine, HERE, key=KEY)) == 1
    ((_, headers, body),) = receiver.got
    for secret in (first, fresh):
        rules.verify(secret, headers, body)


def test_the_same_secret_is_never_stored_alike_and_nothing_of_it_can_be_altered():
    secret = rules.new_secret()
    one, two = sealed.seal(KEY, secret), sealed.seal(KEY, secret)
    assert one != two and max(len(one), len(two)) <= webhook.c.secret.type.length
    data = bytearray(base64.b64decode(one.removeprefix(sealed.SEALED)))
    for place in range(len(data)):
        data[place] ^= 1
        with pytest.raises(ServiceError, match="another"):
            sealed.unseal(KEY, sealed.SEALED + base64.b64encode(data).decode())
        data[place] ^= 1
    assert sealed.unseal(KEY, sealed.SEALED + base64.b64encode(data).decode()) == secret


@pytest.mark.parametrize("key", [None, "other"])
def test_without_its_key_nothing_is_sent_and_nothing_is_lost(bench, receiver, key):
    facts = {"name": "n", "url": receiver.url, "events": ("queued",), "every_job": True}
    _, secret = webhooks.create(bench.engine, bench.tenant_id, **facts, key=KEY)
    bench.submit()
    assert send(Postman(bench.engine, HERE, key=key)) == 1
    assert receiver.got == []
    assert [(row.state, row.attempt) for row in rows(bench)] == [("pending", 1)]
    make_due(bench)
    assert send(Postman(bench.engine, HERE, key=KEY)) == 1
    rules.verify(secret, *receiver.got[0][1:])


def test_what_lay_plain_is_sealed_once(bench, receiver, hook):
    fresh = webhooks.rotate(bench.engine, bench.tenant_id, hook[0])
    assert tuple(stored(bench)) == (fresh, hook[1])
    assert sealed.seal_all(bench.engine, None) == 0
    assert tuple(stored(bench)) == (fresh, hook[1])
    assert sealed.seal_all(bench.engine, KEY) == 1
    after = tuple(stored(bench))
    assert [sealed.unseal(KEY, text) for text in after] == [fresh, hook[1]]
    assert all(text.startswith(sealed.SEALED) for text in after)
    assert sealed.seal_all(bench.engine, KEY) == 0 and tuple(stored(bench)) == after
    bench.submit()
    assert send(Postman(bench.engine, HERE, key=KEY)) == 1
    rules.verify(fresh, *receiver.got[0][1:])
