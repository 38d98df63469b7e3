"""Registries of plants, models, controllers and other members by name, as used by `register_plant` or `get_model`."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

from adaptrack.base.errors import ContractError, InvalidInput, UnknownName, did_you_mean, format_value
from adaptrack.base.presentation import printable

MemberType = TypeVar("MemberType")


class Registry(Generic[MemberType]):
    """Factories of one kind of member, by name.

    Parameters
    ----------
    member_kind
        Noun for a member in error messages, such as "plant".
    register
        Name of the public function that adds a factory, for error messages.
    factories
        Factories by name. A text ``"package.module:name"`` is imported when it is first used.
    arguments
        Names of the positional arguments of every factory.
    member_type
        Class, or union of classes, of what every factory returns.
    """

    def __init__(
        self, member_kind: str, register: str, factories: Mapping[str, Callable[..., MemberType] | str],
        arguments: Sequence[str] = (), member_type: Any = object,
    ) -> None:  # fmt: skip
        self.member_kind, self.register, self.factories = member_kind, register, dict(factories)
        self.arguments, self.member_type = arguments, member_type

    def add(self, name: str, factory: Callable[..., MemberType] | str) -> None:
        """Register a factory under a name.

        Raises InvalidInput for an empty or registered name, for a factory that is neither callable nor
        ``"package.module:name"``, and for one that does not accept the required arguments.
        """
        if not name or not isinstance(name, str):
            raise InvalidInput(f"{self.register}: the {self.member_kind} needs a name, not {name!r}.")
        if name in self.factories:
            raise InvalidInput(f"{self.register}: there is a {self.member_kind} {name!r} already: choose another name.")
        if not callable(factory) and not (isinstance(factory, str) and factory.count(":") == 1):
            raise InvalidInput(
                f"{self.register}: the factory of {name!r} must be callable or 'package.module:name', not {factory!r}."
            )
        if callable(factory):
            self._check_arguments(name, factory)
        self.factories[name] = factory

    def _check_arguments(self, name: str, factory: Callable[..., MemberType]) -> None:
        try:
            signature = inspect.signature(factory)
        except ValueError:  # a function in C has no signature
            return
        try:
            signature.bind_partial(*self.arguments)  # further arguments are allowed: options with or without default
        except TypeError:
            raise InvalidInput(
                f"{self.register}: the factory of {name!r} takes {signature}: it must take "
                f"({', '.join(self.arguments)})."
            ) from None

    def make(self, name: str, *arguments: Any, **options: Any) -> MemberType:
        """Call the factory registered under a name, see `check_name`.

        Raises ContractError when the factory returns anything but a member, or calls `sys.exit`.
        """
        classes = getattr(self.member_type, "__args__", (self.member_type,))
        call = PluginCall(
            f"{self.member_kind} {name!r}: its factory", f"a {' or '.join(kind.__name__ for kind in classes)}"
        )
        member = call(self.factory(name), *arguments, **options)
        if not isinstance(member, self.member_type):
            raise call.refusal(member)
        return member

    def factory(self, name: str) -> Callable[..., MemberType]:
        """Return the factory that is registered under a name, see `check_name`, importing it if necessary."""
        self.check_name(name)
        factory = self.factories[name]
        if isinstance(factory, str):
            module, attribute = factory.split(":")
            factory = getattr(importlib.import_module(module), attribute)
            self._check_arguments(name, factory)
        return factory

    def check_name(self, name: str) -> None:
        """Refuse an unregistered name: UnknownName, with the most similar registered name."""
        if not isinstance(name, str) or name not in self.factories:
            raise UnknownName(f"There is no {self.member_kind} {name!r}. {did_you_mean(str(name), self.factories)}")

    def names(self) -> list[str]:
        """Return the registered names, sorted."""
        return sorted(self.factories)


class PluginCall(NamedTuple):
    """Call of a function that a plug-in defines."""

    function_name: str
    """Plug-in and function, at the beginning of messages, such as ``controller 'mine': step()``."""
    answer: str
    """Answer that the function must return."""

    def __call__(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Call the function; ContractError when it calls `sys.exit`, which would end the whole program."""
        try:
            return function(*arguments, **options)
        except SystemExit as error:
            raise ContractError(
                f"{self.function_name} ended the program (exit code {error.code!r}): it must return {self.answer}."
            ) from error

    def refusal(self, answer: object) -> ContractError:
        """Return the error for an answer that the function must not return."""
        return ContractError(f"{self.function_name} returned {format_value(answer)}: it must return {self.answer}.")


def compile_function(where: str, compiler: Callable[[Any], Any], function: Any, form: str) -> Any:
    """Return the function of a part, such as a plant, as the kernels call it; `form`: its arguments, for the message.

    Raises ContractError, with file, line and remedy, when `compiler`, of `adaptrack.core`, refuses it.
    """
    try:
        return compiler(function)
    except Exception as error:
        raise ContractError(f"{where}: cannot compile its {form}: {error}") from error


class Contract(NamedTuple):
    """Contract of a member, whose clauses a checker tests one by one."""

    member: str
    """Kind and name at the beginning of messages, such as ``prediction model 'mine'``."""

    def require(self, holds: Any, clause: str, evidence: object, remedy: str = "") -> None:
        """Refuse the member unless a clause holds: ContractError with the clause, the evidence and the remedy."""
        if not holds:
            raise self.breach(clause, evidence, remedy)

    def breach(self, clause: str, evidence: object, remedy: str = "") -> ContractError:
        """Return the error for a clause that is broken."""
        return ContractError(f"{self.member}: {clause}: {evidence}{f'; {remedy}' if remedy else ''}.")


def import_plugin(name: str, missing: InvalidInput, announce: Callable[[str], None] | None = None) -> None:
    """Import the module of this dotted name, which registers members.

    announce: called with the name before the code of the module runs for the first time. Raises `missing` if there is
    no such module, and InvalidInput with the file and line at which the code of the module fails.
    """
    if not all(part.isidentifier() for part in name.split(".")):
        raise missing
    if announce is not None and name not in sys.modules:
        announce(name)
    try:
        importlib.import_module(name)
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and f"{name}.".startswith(f"{error.name}."):
            raise missing from None
        lines = traceback.format_exception_only(error)  # source lines of a SyntaxError are indented and skipped below
        reason = printable(next(line for line in lines if not line.startswith(" ")).strip())
        raise InvalidInput(f"plugin {name}: {_failed_line(error)}: {reason}; correct the module.") from error


def _failed_line(error: BaseException) -> str:
    """Return the file and line of a module at which its import failed."""
    if isinstance(error, SyntaxError):
        return f"{error.filename}, line {error.lineno}" if error.filename else "its source"
    importing = re.compile(r"<frozen|.*importlib.__init__\.py$")
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if not importing.match(frame.filename)]
    module = frames[min(1, len(frames) - 1)].filename  # frame 0 is `import_plugin`
    line = [frame.lineno for frame in frames if frame.filename == module][-1]
    return f"{module}, line {line}"
