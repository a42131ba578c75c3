"""Compiling functions that are written with llvmlite's builder.

llvmlite takes 0.2 s to import, and is imported when the first function is compiled.
"""

import ctypes
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Lock
from typing import Any

_LOG = logging.getLogger(__name__)
_LOCK = Lock()

_ALL: list["MachineCode"] = []

Function = Callable[..., None]

Ir = Any
"""Something of llvmlite, which is untyped: a value, a type, a builder, an engine."""


class MachineCode:
    """A function that is compiled when it is first asked for.

    Args:
        name: of the function, for people.
        build: returns the `ir.Function`, begun with `begin_function`.
    """

    def __init__(self, name: str, build: Callable[[], Ir]) -> None:
        self._name = name
        self._build = build
        self._engine: Ir = None
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
            built = self._build()
            self._engine = _compiled(str(built.module))
            types = [ctypes.c_void_p if arg.type.is_pointer else ctypes.c_int64 for arg in built.args]
            self._function = ctypes.CFUNCTYPE(None, *types)(self._engine.get_function_address(built.name))
        except ImportError:
            _LOG.info("%s: there is no llvmlite; a slower twin is used", self._name)
        except Exception:  # noqa: BLE001  (an unknown processor, memory that may not be executed: the twin does)
            _LOG.warning("%s cannot be compiled here; a slower twin is used", self._name, exc_info=True)
        self._tried = True


def compile_all() -> Iterator[None]:
    """Compile what is imported, one function at a time: a process that is then forked has it for its children."""
    for code in _ALL:
        code.function()
        yield


def _compiled(text: str) -> Ir:
    import llvmlite.binding as llvm

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


def begin_function(name: str, pointed_to: Sequence[Ir]) -> tuple[Ir, Ir]:
    """Return a function that returns nothing, in a module of its own, and a builder at its start.

    Args:
        name: of the function.
        pointed_to: what each argument points to, memory that no other one does; None for a 64-bit number.
    """
    from llvmlite import ir

    types = [ir.IntType(64) if kind is None else kind.as_pointer() for kind in pointed_to]
    function = ir.Function(ir.Module(name), ir.FunctionType(ir.VoidType(), types), name)
    for argument in function.args:
        if argument.type.is_pointer:
            argument.add_attribute("noalias")
    return function, ir.IRBuilder(function.append_basic_block())


@contextmanager
def counting(b: Ir, begin: Ir, end: Ir) -> Iterator[Ir]:
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
