"""OpenGL in a child process: a driver that crashes takes the child with it, not the worker.

Problem  A graphics driver can abort, run out of memory or lose its device. Workers must outlive that, and no process that
         forks may ever have held a context.
Method   One child a process, started when first asked for: `python -m farfield.bake.gl.apart` takes calls as pickles on
         stdin ("module:function", arguments) and answers on stdout. What a call keeps (programs, buffers) it keeps in
         its module. A child that ended, answers nonsense or says that its context failed is ContextLost: no fact about
         the input, so the shard is tried again, with a new child. It ends with its parent: its stdin then does.
Cost     0.4 s to start; a sheet of 16 MB takes 10 ms more than in the same process.
"""

import contextlib
import importlib
import os
import pickle
import subprocess
import sys
from typing import Any


class ContextLost(RuntimeError):
    """The process that held the OpenGL context ended in the middle of its work."""


class Child:
    """A process that draws. Not to be shared between threads."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def call(self, target: str, *arguments: Any) -> Any:
        """Return what "module:function" returns there. Raises what it raises, and ContextLost where the child is gone."""
        if self._process is None or self._process.poll() is not None:
            command = [sys.executable, "-m", "farfield.bake.gl.apart"]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            pickle.dump((target, arguments), process.stdin, protocol=5)
            process.stdin.flush()
            good, answer = pickle.load(process.stdout)
        except (BrokenPipeError, EOFError, pickle.UnpicklingError) as error:
            self.end()
            raise ContextLost(f"the process that draws ended with status {process.returncode}") from error
        except BaseException:  # a cancel, say: what is still on its way must not answer the next call
            self.end()
            raise
        if good:
            return answer
        if isinstance(answer, ContextLost):
            self.end()
        raise answer

    def end(self) -> None:
        """Stop the process; the next call starts another."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    with contextlib.suppress(BrokenPipeError):
                        pipe.close()
            self._process = None


_children: dict[int, Child] = {}


def child() -> Child:
    """Return this process's child; one forked from it gets its own."""
    return _children.setdefault(os.getpid(), Child())


def main() -> None:
    # What a driver prints must not mix with our answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    while True:
        try:
            target, arguments = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        module, _, function = target.partition(":")
        told: tuple[bool, Any]
        try:
            told = True, getattr(importlib.import_module(module), function)(*arguments)
        except Exception as error:
            told = False, error
        try:
            data = pickle.dumps(told, protocol=5)
        except Exception:  # an error that cannot travel
            data = pickle.dumps((False, RuntimeError(repr(told[1]))))
        answers.write(data)
        answers.flush()


if __name__ == "__main__":
    main()
