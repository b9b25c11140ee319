"""What a shard says of itself: written by who holds it, the newest word, only what has changed."""

import pytest
import sqlalchemy as sa
from farfield.store import events, news, shards
from farfield.store.engine import read
from farfield_workers.news import News, _changed


def _progress(bench, job_id):
    with read(bench.engine) as tx:
        return [event["data"] for event in events.after(tx, job_id, 0, kind="progress")]


def _held(bench, message):
    return shards.claim(bench.engine, message.shard_id, worker="here")


def test_the_last_word_is_written_before_the_shard_is_done(in_process):
    words = [{"map": {"boxes": [0, 0, 1, 1]}}, *({"share": k / 4, "tiles": [9 - k, k]} for k in range(5))]
    job_id, message = in_process.submit(tell=words)
    in_process.run(message)
    told = _progress(in_process, job_id)
    assert [t["stage"] for t in told] == ["placement"] * len(told)
    assert told[0]["map"] == words[0]["map"]
    assert told[-1]["share"] == 1.0
    assert sum(dict(map(tuple, t["tiles"])).get(0, 0) for t in told[1:]) >= 5
    with read(in_process.engine) as tx:
        kinds = [
            (e["kind"], e["data"].get("stage"), e["data"].get("kind"), e["data"].get("state"))
            for e in events.after(tx, job_id, 0)
        ]
    last = max(k for k, (kind, *_) in enumerate(kinds) if kind == "progress")
    assert last < kinds.index(("shard", "placement", "run", "done"))


def test_only_counts_that_changed_are_written_and_lost_words_lose_no_count(bench):
    job_id, message = bench.submit()
    found = News(bench.engine, _held(bench, message))
    found._keep = lambda: None  # this test writes itself
    shown = [0, 0, 0, 0]
    for n, tiles in enumerate(([5, 0, 2, 1], [5, 0, 1, 1], [5, 0, 0, 1], [4, 0, 0, 0])):
        found.tell({"share": n / 4, "tiles": tiles})
        found.tell({"share": n / 4, "bytes": n})  # says nothing of tiles: those just told stand
        if n == 1:
            continue  # nobody wrote in time
        found.write()
        event = _progress(bench, job_id)[-1]
        assert event["first"] == (n == 0) and event["bytes"] == n
        for k, count in event["tiles"]:
            shown[k] = count
        assert shown == tiles
    found.end()
    assert len(_progress(bench, job_id)) == 3


@pytest.mark.parametrize("taken", ["done", "cancelled"])
def test_who_no_longer_holds_the_shard_writes_nothing(bench, taken):
    job_id, message = bench.submit()
    held = _held(bench, message)
    assert news.tell(bench.engine, held, {"share": 0.1})
    with bench.engine.begin() as tx:
        if taken == "done":
            tx.execute(sa.update(shards.shard).where(shards.shard.c.id == held.shard_id).values(claims=held.claim + 1))
        else:
            tx.execute(sa.update(shards.job).where(shards.job.c.id == job_id).values(state="cancelled"))
    assert not news.tell(bench.engine, held, {"share": 0.2})
    assert [t["share"] for t in _progress(bench, job_id)] == [0.1]


def test_a_database_that_does_not_answer_costs_the_news_alone(bench, monkeypatch):
    job_id, message = bench.submit()
    found = News(bench.engine, _held(bench, message))
    found._keep = lambda: None

    def dead(*of):
        raise sa.exc.OperationalError("", {}, Exception("gone"))

    found.tell({"tiles": [3, 0]})
    with monkeypatch.context() as patch:
        patch.setattr("farfield_workers.news.tell", dead)
        found.write()
    found.tell({"tiles": [2, 1]})
    found.write()
    found.end()
    (event,) = _progress(bench, job_id)
    assert event["first"] and event["tiles"] == [[0, 2], [1, 1]], "the first that arrives is complete"


def test_changes_are_places_and_counts():
    assert _changed(None, [0, 4, 0, 1]) == [[1, 4], [3, 1]]
    assert _changed([0, 4, 0, 1], [0, 3, 0, 1]) == [[1, 3]]
