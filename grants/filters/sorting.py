"""Sorting: the order of an array's elements says which is which, also without their names.

Elements are put in the order of their bytes as they are sent, so what is left of them decides
alone: nothing of the order in which the publisher wrote them remains.
"""

from collections.abc import Callable

from grants.filters.codegen import Buffer, Cursor, SourceWriter
from grants.filters.layout import Type


def sorting(element: Type) -> Callable[[Buffer], tuple[Buffer, int]]:
    """The function from the elements of an array to the same in order, and how many they are.

    An element has at least one byte, as else nothing would say how many there are. It raises one
    of `codegen.LAYOUT_ERRORS` for bytes that are no such elements.
    """
    split = _splitter(element)

    def rewrite(content: Buffer) -> tuple[Buffer, int]:
        found = sorted(split(bytes(content)))
        return b"".join(found), len(found)

    return rewrite


def _splitter(element: Type) -> Callable[[bytes], list[bytes]]:
    source = SourceWriter("b")
    source.line("p=0;l=[]")
    with source.block("while p<len(b)"):
        cursor = Cursor(source)
        cursor.position = ("p", 0)
        cursor.skip(element)
        source.line(f"e={cursor.at()}")
        source.line("l.append(b[p:e])")
        source.line("p=e")
    source.line("if p!=len(b): raise ValueError")
    source.line("return l")
    return source.compile()
