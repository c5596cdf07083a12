"""Statements of kernels, which are written in a small part of Python, in other languages."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Collection, Iterator

from kreisel.errors import RunError
from kreisel.languages.dialects import Dialect

OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Lt: "<",
    ast.Gt: ">",
    ast.LtE: "<=",
    ast.GtE: ">=",
    ast.Eq: "==",
}
MATH = ("fma", "sqrt", "sin", "cos", "exp", "log")  # which languages have
OWN = ("put_pair",)  # a function that each file defines, and no helper that files share
INTEGERS = ("whole", "range")  # functions whose values are integers


class Writer:
    """A text of kernels in a dialect.  `integers`: names that are integers from outside."""

    def __init__(self, dialect: Dialect, integers: Collection[str] = ()):
        self.dialect, self._integers = dialect, set(integers)
        self._once: set[str] = set()
        self._read: set[str] = set()

    def body(self, text: str, indent: int, known: Collection[str] = ()) -> list[str]:
        """The statements of a text; what they assign is declared, but for `known` names."""
        tree = ast.parse(text)
        counts = Counter(name for node in ast.walk(tree) for name, _ in _values(node) if name not in known)
        integers = self._whole_names(tree, counts)
        self._integers |= integers
        at_once = [name for node in tree.body if _sets_one(node) for name, _ in _values(node)]
        self._once = {name for name in at_once if counts[name] == 1}
        reading = (n for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load))
        self._read = {node.id for node in reading}
        later = [
            name for name in counts if name not in self._once and (name in self._read or not _unpacked(tree, name))
        ]
        lines = [self.dialect.local[name in integers].format(self.dialect.name_of(name)) for name in later]
        return [" " * indent + line for line in [*lines, *self._block(tree.body, 0)]]

    def _whole_names(self, tree: ast.AST, names: Collection[str]) -> set[str]:
        """Those that only integers are assigned to."""
        found, before = set(names), None
        while found != before:
            before = set(found)
            known = found | self._integers
            for node in ast.walk(tree):
                for name, value in _values(node):
                    if name in found and value is not None and not _is_whole(value, known):
                        found.discard(name)
        return found

    def _block(self, nodes: list[ast.stmt], indent: int) -> list[str]:
        return [" " * indent + line for node in nodes for line in self._statement(node)]

    def _statement(self, node: ast.stmt) -> Iterator[str]:
        d = self.dialect
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                yield from self._together(targets, values)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Name(id=source)):
                for k, target in enumerate(targets):
                    if ast.unparse(target) not in self._read:
                        continue
                    yield f"{self.expression(target)} = {d.name_of(source)}[{k + d.first}]{d.end}"
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name in self._once:
                form = d.once[name in self._integers]
                yield form.format(d.name_of(name), self.expression(value))
            case ast.Assign(targets=[target], value=value):
                yield f"{self.expression(target)} = {self.expression(value)}{d.end}"
            case ast.AugAssign(target=target, op=op, value=value):
                yield f"{self.expression(target)} {OPERATORS[type(op)]}= {self.expression(value)}{d.end}"
            case ast.For(target=ast.Name(id=name), iter=ast.Call(args=args), body=body):
                start, stop = ("0", args[0]) if len(args) == 1 else (self.expression(args[0]), args[1])
                head = d.down if len(args) == 3 else d.up
                yield head.format(var=d.name_of(name), start=start, stop=self.expression(stop))
                yield from [*self._block(body, 4), d.close]
            case ast.While(test=test, body=body):
                yield from [d.loop_while.format(self._test(test)), *self._block(body, 4), d.close]
            case ast.If(test=test, body=body, orelse=orelse):
                yield from [d.condition.format(self._test(test)), *self._block(body, 4)]
                yield from [d.otherwise.format(), *self._block(orelse, 4)] if orelse else []
                yield d.close
            case ast.Expr(value=ast.Call() as call):
                yield f"{self.expression(call)}{d.end}"
            case ast.Return(value=None) | ast.Break():
                yield f"{'return' if isinstance(node, ast.Return) else 'break'}{d.end}"
            case _:
                raise RunError(f"expected a statement that {d.name} can say too, got {ast.unparse(node)!r}")

    def _together(self, targets: list[ast.expr], values: list[ast.expr]) -> Iterator[str]:
        """Assignments at the same time: through other names where a value needs what was assigned before it."""
        names, end = [self.expression(target) for target in targets], self.dialect.end
        needs = [{n.id for n in ast.walk(value) if isinstance(n, ast.Name)} for value in values]
        new = [self.expression(value) for value in values]
        for i, target in enumerate(targets):
            if any(ast.unparse(target) in later for later in needs[i + 1 :]):
                yield self.dialect.once[0].format(f"new_{names[i]}", new[i])
                new[i] = f"new_{names[i]}"
        moved = [i for i, value in enumerate(new) if value.startswith("new_")]
        for i in [*(i for i in range(len(new)) if i not in moved), *moved]:
            yield f"{names[i]} = {new[i]}{end}"

    def _test(self, node: ast.expr) -> str:
        if isinstance(node, ast.Compare):
            return self.expression(node)
        if isinstance(node, ast.UnaryOp):
            return self.dialect.no.format(self.expression(node.operand))
        return self.dialect.yes.format(self.expression(node))

    def text(self, expression: str) -> str:
        """An expression from its text."""
        return self.expression(ast.parse(expression, mode="eval").body)

    def expression(self, node: ast.expr) -> str:
        """An expression; operations are in the order of the text."""
        match node:
            case ast.Name(id=name):
                return self.dialect.name_of(name)
            case ast.Constant(value=int() as value):
                return str(value)
            case ast.Constant(value=float() as value):
                return self.dialect.literal(value)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return f"(-{self.expression(operand)})"
            case ast.BinOp(left=left, op=op, right=right):
                return f"({self.expression(left)} {OPERATORS[type(op)]} {self.expression(right)})"
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return f"{self.expression(left)} {OPERATORS[type(op)]} {self.expression(right)}"
            case ast.IfExp(test=test, body=body, orelse=orelse):
                parts = self._test(test), self.expression(body), self.expression(orelse)
                return self.dialect.either.format(*parts)
            case ast.Call(func=ast.Name(id=name), args=args):
                own = self.dialect.mark if name in OWN else ""
                prefix = "" if name in MATH else own or self.dialect.prefix
                return f"{prefix}{name}({', '.join(map(self.expression, args))})"
        raise RunError(f"expected an expression that {self.dialect.name} can say too, got {ast.unparse(node)!r}")


def _sets_one(node: ast.stmt) -> bool:
    return isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)


def _values(node: ast.AST) -> list[tuple[str, ast.expr | None]]:
    """The names that a statement assigns to, and what; None for an integer."""
    match node:
        case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
            return [(t.id, v) for t, v in zip(targets, values, strict=True) if isinstance(t, ast.Name)]
        case ast.Assign(targets=[ast.Tuple(elts=targets)]):
            return [(t.id, None) for t in targets if isinstance(t, ast.Name)]
        case (
            ast.Assign(targets=[ast.Name(id=name)], value=value) | ast.AugAssign(target=ast.Name(id=name), value=value)
        ):
            return [(name, value)]
        case ast.For(target=ast.Name(id=name)):
            return [(name, None)]
    return []


def _unpacked(tree: ast.AST, name: str) -> bool:
    """Whether a name comes from the numbers of another, as in `a, b = c`."""
    tuples = (n.targets[0] for n in ast.walk(tree) if isinstance(n, ast.Assign) and isinstance(n.value, ast.Name))
    return any(name in ast.unparse(t).strip("()").split(", ") for t in tuples if isinstance(t, ast.Tuple))


def _is_whole(node: ast.expr, integers: Collection[str]) -> bool:
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int)
        case ast.Name(id=name):
            return name in integers
        case ast.BinOp(left=left, op=op, right=right):
            return not isinstance(op, ast.Div) and _is_whole(left, integers) and _is_whole(right, integers)
        case ast.Call(func=ast.Name(id=name), args=args):
            return name in INTEGERS or (name == "min" and all(_is_whole(a, integers) for a in args))
    return False
