"""Every example in the documentation of `import softcal` runs, and every name that it gives has one."""

import doctest
import inspect
from collections.abc import Iterator

import pytest

import softcal

WITHOUT_EXAMPLE = {"__version__"}


def _documented() -> Iterator[tuple[str, object]]:
    """Yield every public name with what it is, and the public methods of its classes."""
    for name in sorted(set(softcal.__all__) - WITHOUT_EXAMPLE):
        thing = getattr(softcal, name)
        yield name, thing
        if inspect.isclass(thing) and thing.__module__.startswith("softcal.app.api"):
            for method, function in vars(thing).items():
                if not method.startswith("_") and isinstance(function, classmethod | type(_documented)):
                    yield f"{name}.{method}", getattr(thing, method)


DOCUMENTED = dict(_documented())


@pytest.mark.parametrize("name", DOCUMENTED)
def test_the_examples_of_a_public_name_run(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    finder, runner = (
        doctest.DocTestFinder(recurse=False),
        doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE),
    )
    examples = finder.find(DOCUMENTED[name], name, globs={})
    for example in examples:
        runner.run(example)
    result = runner.summarize(verbose=False)
    assert result.attempted > 0, f"softcal.{name} has no example"
    assert result.failed == 0
