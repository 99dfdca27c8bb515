"""Pages of `make docs` that come from other folders, and the figures of `results/` in all pages."""

import re
from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

from samarl.report.build import task_leaderboard
from samarl.report.leaderboard import task_rows
from samarl.report.marl_eval import marl_eval_json
from tools.update_docs import fill, without_marks

ROOT = Path(__file__).parents[1]
SUBMISSIONS = ROOT / "leaderboard"
RESULTS = (
    "table1",
    "table2",
    "transfer",
    "places",
    "right_of_way",
    "robustness",
    "physics",
    "ablations",
    "prediction",
)
# Pages from other folders: the file in the repository, and the page that shows it.
PAGES = {f"results/{name}.md": f"tables/{name}.md" for name in RESULTS} | {
    "examples/README.md": "examples.md",
    "examples/first_ten_minutes.ipynb": "first_ten_minutes.ipynb",
}


@event_priority(100)  # before notebooks are looked for
def on_files(files: Files, config: Any) -> Files:
    """Add the pages from other folders."""
    for source, page in PAGES.items():
        path = ROOT / source
        if path.suffix == ".ipynb":
            folder, site = str(path.parent), config.site_dir
            files.append(File(path.name, folder, site, config.use_directory_urls))
        else:
            content = path.read_text(encoding="utf-8")
            files.append(File.generated(config, page, content=content))
    for name in ("leaderboard.css", "leaderboard.js"):
        script = ROOT / "samarl/report/site" / name
        files.append(File.generated(config, f"site/{name}", abs_src_path=str(script)))
    content = marl_eval_json(task_rows(SUBMISSIONS))
    files.append(File.generated(config, "leaderboard_marl_eval.json", content=content))
    for figure in (ROOT / "results").glob("*.png"):
        files.append(File.generated(config, f"tables/{figure.name}", abs_src_path=str(figure)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in the figures, and replace links to files that are not pages by their names.

    Raises:
        FileNotFoundError: the target of a link does not exist.
    """
    here = page.file.src_path
    source = next((s for s, target in PAGES.items() if target == here), f"docs/{here}")
    folder = (ROOT / source).parent

    def resolve(match: re.Match[str]) -> str:
        text, (target, _, anchor) = match[1], match[2].partition("#")
        if not target or "://" in target:
            return match[0]
        path = (folder / target).resolve()
        if not path.exists():
            raise FileNotFoundError(f"{source} links to {target}, which does not exist")
        path = path.relative_to(ROOT)
        if path.is_relative_to("docs"):
            return match[0] if source.startswith("docs/") else _link(text, path.name, anchor)
        if str(path) in PAGES:
            return _link(text, PAGES[str(path)], anchor)
        return f"`{path}`" if text.strip("`") == str(path) else f"{text} (`{path}`)"

    def _link(text: str, target: str, anchor: str) -> str:
        up = "../" * here.count("/")
        return f"[{text}]({up}{target}{'#' + anchor if anchor else ''})"

    text = without_marks(fill(markdown))
    return re.sub(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)", resolve, text)


def on_post_template(output: str, template_name: str, **_: Any) -> str:
    """Let the page of missing pages find its style and links, wherever the site lies."""
    if template_name != "404.html":
        return output
    hint = '<p>This page does not exist: see the <a href="index.html">home page</a>, or search.</p>'
    output = output.replace("</h1>", f"</h1>{hint}", 1)
    return re.sub(r'(?<=[=( ])"/(\w*)', lambda address: f'"{address[1] or "."}', output)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Fill in leaderboards, and wrap the wide rows that commands print in a notebook."""
    html = re.sub(
        r"<!-- leaderboard (.+) -->", lambda mark: task_leaderboard(mark[1], SUBMISSIONS), html
    )
    if not page.file.src_path.endswith(".ipynb"):
        return html
    return re.sub(
        r"(?:^|(?<=<pre>))\|.*\n\|-.*\n(?:\|.*\n)+", _wrapped_rows, html, flags=re.MULTILINE
    )


def _wrapped_rows(table: re.Match[str]) -> str:
    """Return a printed Markdown table as one group of named cells per row."""
    header, _, *rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table[0].splitlines()
    ]
    return "".join(
        '<span class="printed-row">'
        + "".join(
            f"<span><b>{name}</b>{value}</span>"
            for name, value in zip(header, row, strict=True)
            if value
        )
        + "</span>"
        for row in rows
    )
