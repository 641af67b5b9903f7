"""How kernels are compiled: what only kernels call becomes LLVM code for its callers, not machine code.

numba makes every compiled function ready to be called from Python: it optimises the function with all that it calls,
and emits the machine code of all of it. LLVM links and optimises the function again in each of its callers. For a
function that Python never calls, the first of these is lost, and it was a quarter of the time to compile.

The classes replace methods of numba that are not part of its public interface, so pyproject.toml limits
numba to the versions that have them.
"""

from typing import Any

import llvmlite.binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, compile_result


class KernelLibrary(JITCodeLibrary):
    """Machine code of a kernel with its own copies of all that it calls.

    Of a function that several libraries define, the process uses the copy that it loaded first. The copies are rounded
    alike only if they were optimised alike, so results would depend on which kernels were compiled and which loaded.
    """

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        super()._optimize_final_module()


class LinkedLibrary(JITCodeLibrary):
    """LLVM code of a function and of those that it calls, to be linked into its callers."""

    @classmethod
    def of(cls, codegen: Any, name: str, bitcode: bytes) -> "LinkedLibrary":
        """Return the library of saved LLVM code."""
        library = cls(codegen, name)
        library._final_module = library._shared_module = llvmlite.binding.parse_bitcode(bitcode)
        library._finalized = True
        return library

    def _optimize_final_module(self) -> None:
        """Do nothing: the caller is optimised with this code in it."""

    def _finalize_final_module(self) -> None:
        """Emit no machine code."""
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return zero: there is no address without machine code."""
        return 0

    @property
    def codegen(self) -> "LinkedLibrary":
        """Return what the environment of the function is given to."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: an environment belongs to machine code. That of the caller gets it."""

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """Return what is saved."""
        return self.name, "linked", self._get_module_for_linking().as_bitcode()


class _IntoLibrary(Compiler):
    """numba's compiler, with another library for what it compiles."""

    library: type[JITCodeLibrary]

    def define_pipelines(self) -> Any:
        """Return numba's passes, which compile into the library that is there."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().define_pipelines()


class KernelCompiler(_IntoLibrary):
    """Compiler of kernels."""

    library = KernelLibrary


class LinkedCompiler(_IntoLibrary):
    """Compiler of functions that only kernels call."""

    library = LinkedLibrary


def rebuild(target: Any, saved: tuple[Any, ...]) -> CompileResult:
    """Return a compiled function from what `CompileResult._reduce` returned in another process."""
    libdata, fndesc, environment, signature, objectmode, lifted, annotation, reload_init, envs = saved
    name, kind, code = libdata
    if kind != "linked":
        return CompileResult._rebuild(target, *saved)
    library = LinkedLibrary.of(target.codegen(), name, code)
    return compile_result(
        target_context=target, typing_context=target.typing_context, library=library, environment=environment,
        entry_point=target.get_executable(library, fndesc, environment), fndesc=fndesc, type_annotation=annotation,
        signature=signature, objectmode=objectmode, lifted=lifted, reload_init=reload_init, referenced_envs=envs,
    )  # fmt: skip
