"""The compilation of functions that are only copied into others.

Numba optimises each function by itself and makes machine code of it. Copied into a kernel, the
function is optimised again, so both would be in vain: half of the time of a compilation.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonTypeInference


class InlineCompiler(CompilerBase):
    """Numba's compiler without what follows the translation to LLVM's language."""

    def define_pipelines(self) -> list[Any]:
        """Return the passes."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_CollectSource, NopythonTypeInference)
        passes.finalize()
        return [passes]


@register_pass(mutates_CFG=False, analysis_only=True)
class _CollectSource(FunctionPass):
    """Let the following passes put the function into a `_Source`."""

    _name = "collect_source"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.library = _Source(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


class _Source(JITCodeLibrary):
    """A function in LLVM's language, and those that it calls."""

    @property
    def codegen(self) -> Any:
        """Whoever asks wants to set the function's environment, which it does not need."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing."""

    def finalize(self) -> None:
        """Add the functions that this one calls."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return none."""
        return 0
