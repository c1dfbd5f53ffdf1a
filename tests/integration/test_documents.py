"""Python and rules of docs/ are taken as they stand, commands are parsed; ``make commands`` runs these, and
test_examples.py the example of README.md."""

import ast
import inspect
import re
import shutil
from pathlib import Path

import pytest
from short_clip import ROOT

import planview
from planview.cli import main, make_app
from planview.counting.rules import load_rules
from stereo.doctor.hypotheses import HYPOTHESES
from tools.typed import CANNOT_RUN, PAGES, RULES, blocks, commands, words

ALL = sorted(
    {command for page in PAGES for language, text in blocks(page) if not language for command in commands(text)}
)
WITH_BLOCKS = [
    page
    for page in PAGES
    if page.name != "README.md" and any(language in ("python", "toml") for language, _ in blocks(page))
]


@pytest.mark.parametrize("command", ALL)
def test_command_of_the_documents_has_these_options(command):
    app = make_app(words(command))
    function, _, unused = app.parse_args(words(command), exit_on_error=False, print_error=False)
    assert callable(function)
    assert not unused


CALLS = sorted(
    {
        call
        for page in PAGES
        for call in re.findall(r"`(?:\w+ = )?(planview\.[^`]*\))`", page.read_text(encoding="utf-8"))
        if "..." not in call
    }
)


@pytest.mark.parametrize("call", CALLS)
def test_call_in_the_text_of_the_documents_has_these_arguments(call):
    outer = ast.parse(call, mode="eval").body
    for node in (node for node in ast.walk(outer) if isinstance(node, ast.Call)):
        function = eval(ast.unparse(node.func), {"planview": planview})
        assert inspect.signature(function).bind(*node.args, **{str(one.arg): one.value for one in node.keywords})


def test_messages_in_troubleshooting_are_those_of_the_program():
    files = [file for room in ("calib", "stereo", "planview") for file in (ROOT / room).rglob("*.py")]
    sources = "\n".join(re.sub(r'"\n *f?"', "", file.read_text(encoding="utf-8")) for file in files)
    sources += "\n".join(hypothesis.name for hypothesis in HYPOTHESES)
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([^`]*)`", page, re.MULTILINE)
    parts = [part.strip(" )%,") for row in rows for part in re.split(r"\.\.\.|\(", row)]
    assert len(rows) > 8
    assert [part for part in parts if part not in sources] == []


@pytest.mark.parametrize("pattern", CANNOT_RUN)
def test_reason_not_to_run_is_still_needed(pattern):
    assert any(re.match(pattern, command) for command in [*ALL, "planview view"])


@pytest.fixture(scope="module")
def run_folder(short_clip, tmp_path_factory) -> Path:
    """A folder with a recording and a finished run of it, as the documents assume one."""
    folder = tmp_path_factory.mktemp("documents")
    shutil.copytree(short_clip / "data", folder / "data")
    shutil.copytree(folder / "data" / "synthetic" / "demo", folder / "my_recording")
    shutil.copy(folder / "my_recording" / "truth.csv", folder)
    run, tracks = folder / "out", folder / "tracks_pedpy.txt"
    for argv in (["run", folder / "my_recording", "--out", run], ["export", run, "--to", "pedpy", "--out", tracks]):
        with pytest.raises(SystemExit) as done:
            main(list(map(str, argv)))
        assert not done.value.code
    (folder / "rules.toml").write_text(RULES)
    return folder


@pytest.mark.parametrize("page", WITH_BLOCKS, ids=lambda page: page.name)
def test_blocks_of_a_page_run(page, run_folder, tmp_path, monkeypatch):
    import matplotlib as mpl

    mpl.use("Agg")
    shutil.copytree(run_folder, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    for language, text in blocks(page):
        if language == "python":
            if "import pedpy" in text:
                pytest.importorskip("pedpy")
            exec(compile(text, page.name, "exec"), {"__name__": "__main__"})
        elif language == "toml" and "[[tripwire]]" in text:
            name = "rules.toml" if "from_m" in text else "rules_px.toml"  # the clip has fewer pixels than the example
            Path(name).write_text(text)
            assert load_rules(Path(name))
