"""Functions that are only called by compiled code: they are compiled once, with their callers.

numba optimises each function together with all that it calls and makes machine code of it, and its callers repeat that:
a function six calls deep is compiled six times. Here it is only typed and lowered to LLVM's intermediate language, and
the function that Python calls does the rest.
"""

from __future__ import annotations

from typing import Any

from llvmlite.binding import Linkage
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, DefaultPassBuilder, _LowerResult
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class _CodePart(JITCodeLibrary):
    """The code of one such function alone: callers link it and, separately, what it calls."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._finalize_dynamic_globals()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"  # as numba links functions: there may be several of one name
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        self._ensure_finalized()
        return self._final_module


@register_pass(mutates_CFG=True, analysis_only=False)
class _PartLowering(NativeLowering):
    _name = "part_lowering"

    def run_pass(self, state: Any) -> bool:
        state.library = library = _CodePart(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags = state.flags.copy()
        state.flags.no_compile = True
        super().run_pass(state)
        made = state["cr"]
        # Callers find the function by this; there is nothing to call.
        entry = _dynfunc.make_function(made.fndesc.lookup_module(), made.fndesc.qualname, "", 0, made.env, (library,))
        state.targetctx.insert_user_function(entry, made.fndesc, [library, *library._linking_libraries])
        state.reload_init.extend(library._reload_init)
        state["cr"] = _LowerResult(made.fndesc, made.call_helper, cfunc=entry, env=made.env)
        return True


class PartCompiler(Compiler):
    """The compiler to give as ``pipeline_class`` to ``numba.extending.register_jitable``."""

    def define_pipelines(self) -> list[Any]:
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.add_pass_after(_PartLowering, NativeLowering)
        manager.passes = [item for item in manager.passes if item[0] is not NativeLowering]
        manager._finalized = False
        manager.finalize()
        return [manager]
