"""A compiled kernel that lies on disk is used again only while its sources are the same."""

import subprocess
import sys
from pathlib import Path

HELPER = "from mrsan.kernels import function\n\n@function\ndef helper(x):\n    return x + {}\n"
MIDDLE = "from mrsan.kernels import function\nfrom helper import helper\n\n"
MIDDLE += "@function\ndef middle(x):\n    return helper(x)\n"
ENTRY = """
from mrsan.kernels import kernel
from middle import middle

@kernel
def entry(chunks, out):
    out[0] = middle(out[0])

if __name__ == "__main__":
    import numpy as np
    out = np.zeros(1)
    entry(1, out)
    loaded = sum(entry.serial.stats.cache_hits.values())
    print(int(out[0]), loaded)
"""


def test_a_change_two_imports_away_compiles_a_kernel_anew(tmp_path: Path) -> None:
    (tmp_path / "entry.py").write_text(ENTRY)
    (tmp_path / "middle.py").write_text(MIDDLE)

    def played(added: int) -> str:
        (tmp_path / "helper.py").write_text(HELPER.format(added))
        command = [sys.executable, "-B", "entry.py"]
        return subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout

    assert played(1) == "1 0\n"
    assert played(1) == "1 1\n"
    assert played(25) == "25 0\n"
