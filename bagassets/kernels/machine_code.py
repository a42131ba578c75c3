"""Compiling functions that are written with llvmlite's builder.

llvmlite takes 0.2 s to import, and is imported when the first function is compiled.
"""

import ctypes
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Lock
from typing import Any

__all__ = ["MachineCode", "compile_all", "counting"]

_LOG = logging.getLogger(__name__)
_LOCK = Lock()

_ALL: list["MachineCode"] = []

Function = Callable[..., None]


class MachineCode:
    """A function that is compiled when it is first asked for.

    Args:
        name: of the function that `build` defines.
        arguments: their C types.
        build: returns the `ir.Module`.
    """

    def __init__(self, name: str, arguments: Sequence[Any], build: Callable[[], Any]) -> None:
        self._name = name
        self._signature = ctypes.CFUNCTYPE(None, *arguments)
        self._build = build
        self._engine: Any = None
        self._function: Function | None = None
        self._tried = False
        _ALL.append(self)

    def function(self) -> Function | None:
        """Return the function, which releases the interpreter lock; None if it cannot be had here."""
        if not self._tried:
            with _LOCK:
                if not self._tried:
                    self._compile()
        return self._function

    def _compile(self) -> None:
        try:
            self._engine = _compiled(str(self._build()))
            self._function = self._signature(self._engine.get_function_address(self._name))
        except ImportError:
            _LOG.info("%s: there is no llvmlite; a slower twin is used", self._name)
        except Exception:  # noqa: BLE001  (an unknown processor, memory that may not be executed: the twin does)
            _LOG.warning("%s cannot be compiled here; a slower twin is used", self._name, exc_info=True)
        self._tried = True


def compile_all() -> Iterator[None]:
    """Compile what is imported, one function a step: a process that is then forked has it for its children."""
    for code in _ALL:
        code.function()
        yield


def _compiled(text: str) -> Any:
    import llvmlite.binding as llvm  # noqa: PLC0415

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly(text)
    machine = llvm.Target.from_default_triple().create_target_machine(
        opt=3, cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten()
    )
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(module, passes)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return engine


@contextmanager
def counting(b: Any, begin: Any, end: Any) -> Iterator[Any]:
    """Build a loop: what is built inside is done for each i64 from `begin`, while it is less than `end`."""
    before, head = b.block, b.append_basic_block("head")
    body, after = b.append_basic_block("body"), b.append_basic_block("after")
    b.branch(head)
    b.position_at_end(head)
    number = b.phi(begin.type)
    number.add_incoming(begin, before)
    b.cbranch(b.icmp_signed("<", number, end), body, after)
    b.position_at_end(body)
    yield number
    number.add_incoming(b.add(number, begin.type(1)), b.block)
    b.branch(head)
    b.position_at_end(after)
