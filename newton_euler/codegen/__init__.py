"""Compile equations of motion and integrators to machine code through LLVM, with a cache on disk.

There are two ways. First, `expression` traces the arithmetic of a scene's equations into a graph. `emit`
writes the graph as straight-line code, `rolled` writes large graphs as loops, and `compile` makes a function
y = f(x). Second, `native` marks Python functions of a simple subset, which `translate` turns into LLVM text.
Both kinds of code can process several inputs at once, one in each *lane* (element) of the vector registers.
`fingerprint` and `cache` decide when machine code on disk is used again. Start reading with `compile`.
"""
