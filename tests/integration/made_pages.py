"""What interactive pages hold."""

import json
from pathlib import Path
from typing import Any


def data_of(page: Path) -> Any:
    """Return the data of a page, which its script draws."""
    text = page.read_text("utf-8")
    return json.loads(text.split('<script id="data" type="application/json">')[1].split("</script>")[0])
