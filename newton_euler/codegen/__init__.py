"""Native code through LLVM, from traced programs and from a subset of Python, with a cache on disk.

`expression` traces arithmetic into a graph. `emit` writes a graph as straight-line code, `rolled` writes
large graphs as loops, and `compile` makes a native function y = f(x) of both. `native` marks functions in a
subset of Python, which `translate` turns into LLVM text, for one run or for several in lanes. `fingerprint`
and `cache` decide when machine code on disk is used again. Start reading with `compile`.
"""
