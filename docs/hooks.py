"""What the pages of `make docs` need besides the files of this folder."""

import re
from pathlib import Path
from typing import Any

from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
TABLES = [f"../results/{name}.md" for name in ("table1", "ablations", "transfer", "prediction")]
PAGES = (*TABLES, "../examples/first_ten_minutes.ipynb")  # from elsewhere


@event_priority(100)  # before notebooks are looked for
def on_files(files: Files, config: Any) -> Files:
    """The committed tables and the notebook are pages too."""
    examples, site = str(ROOT / "examples"), config.site_dir
    files.append(File("first_ten_minutes.ipynb", examples, site, config.use_directory_urls))
    for table in TABLES:
        content = (ROOT / "docs" / table).read_text(encoding="utf-8")
        files.append(File.generated(config, Path(table).name, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """What lies outside of the pages is named, not linked to; it must be there."""

    def named(match: re.Match[str]) -> str:
        text, target = match[1], match[2].partition("#")[0]
        if target in PAGES:
            return f"[{text}]({Path(target).name})"
        if not (ROOT / "docs" / target).exists():
            raise FileNotFoundError(f"{page.file.src_path} links to {target}, which is not there")
        path = (ROOT / "docs" / target).resolve().relative_to(ROOT)
        return f"`{path}`" if text.strip("`") == str(path) else f"{text} (`{path}`)"

    def table(match: re.Match[str]) -> str:
        """Insert a file of tables without its title, one heading level deeper."""
        _, content = (ROOT / match[1]).read_text(encoding="utf-8").split("\n", 1)
        return re.sub("^#", "##", content, flags=re.MULTILINE)

    markdown = re.sub(r"<!-- (results/\w+\.md) -->", table, markdown)
    return re.sub(r"\[([^\]]+)\]\((\.\./[^)]+)\)", named, markdown)
