"""The vectors of `pixelate` by the number of squares: pictures, and what is left of them."""


def pictures() -> list[dict[str, object]]:
    """`pixelate` of the data of an image, all of whose bytes differ; None: it is dropped."""
    region = {"x": 1, "y": 1, "width": 2, "height": 2}
    grey = {"across": 2, "levels": 256}
    cases: dict[str, tuple[tuple[int, int, str, int], dict[str, int], str | None]] = {
        "two squares across a square picture": (
            (4, 4, "mono8", 4),
            {"across": 2},
            "000002020000020208080a0a08080a0a",
        ),
        "the longer side counts": ((2, 5, "mono8", 5), {"across": 2}, "00000003030000000303"),
        "the longer side counts, upright": ((5, 2, "mono8", 2), {"across": 2}, "00000000000006060606"),
        "a side that does not divide is rounded up": ((1, 7, "mono8", 7), {"across": 3}, "00000003030306"),
        "more squares than pixels": ((1, 4, "mono8", 4), {"across": 9}, "00000202"),
        "the larger of both": ((1, 6, "mono8", 6), {"across": 3, "block": 4}, "000000000404"),
        "padding counts for nothing": ((2, 2, "mono8", 5), {"across": 1}, "00000000000000000000"),
        "a region has the squares of the whole": (
            (4, 4, "mono8", 4),
            {"across": 2, **region},
            "000102030400020708080a0b0c0d0e0f",
        ),
        "a grey at the edge of a region is that of the whole square": (
            (4, 4, "mono8", 4),
            {**grey, **region},
            "0001020304020407080a0c0b0c0d0e0f",
        ),
        "three colours": ((1, 2, "rgb8", 6), grey | {"across": 1}, "020202020202"),
        "sixteen bits, by the first pixel": ((1, 3, "mono16", 6), {"across": 1}, "000100010001"),
        "sixteen bits in grey": ((1, 3, "mono16", 6), grey, None),
        "an unknown encoding": ((2, 2, "bayer_rggb8", 2), {"across": 1}, None),
        "rows that are missing": ((5, 4, "mono8", 2), {"across": 1}, None),
    }
    return [
        {
            "name": name,
            "height": high,
            "width": wide,
            "encoding": encoding,
            "step": step,
            "data": bytes(range(high * step)).hex(),
            "parameters": parameters,
            "result": result,
        }
        for name, ((high, wide, encoding, step), parameters, result) in cases.items()
    ]
