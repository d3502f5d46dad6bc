"""The pictures of the README: what they show, and that they are small and made anew without a difference."""

from __future__ import annotations

import numpy as np
from PIL import Image

from golden.scenes.embedded.scene import cached_embedded_model
from msv2.studies.gallery import study


def test_pictures_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "PANEL", (64, 48))
    assert study.main(["--size", "96x54", "--out", str(tmp_path / "new")]) == 0
    foveated = np.asarray(Image.open(tmp_path / "new" / "foveated.png").convert("RGB"))
    panel = np.asarray(Image.open(tmp_path / "new" / "renderers.png").convert("RGB"))
    assert foveated.shape == (54 + 18, 2 * 96, 3) and panel.shape == (2 * (48 + 18), 4 * 64, 3)
    frame, levels = foveated[18:, :96], foveated[18:, 96:]
    assert frame.std() > 20 and not np.array_equal(frame, levels)


def test_levels_have_the_shares_that_training_kept():
    model = cached_embedded_model()
    bound = study.leveled(model).quality_bound
    shares = [(bound > level).mean() for level in range(4)]
    assert shares[0] == 1.0 and shares == sorted(shares, reverse=True) and 0.5 < shares[3] < 0.9
