"""The facts as lines for a terminal."""

from collections.abc import Iterator
from typing import Any

_LISTED = 20  # photos or pairs spelled out


def scene_lines(facts: dict[str, Any]) -> Iterator[str]:
    verdict = "accepted" if facts["accepted"] else "not accepted"
    yield facts["partial"] or f"{facts['placed']} of {facts['photos']} photos placed"
    yield f"poses {verdict} ({facts['method']})"
    for caution in facts["cautions"]:
        yield f"  caution: {caution}"
    if any(facts["origin"]):
        place = ", ".join(f"{v:.15g}" for v in facts["origin"])
        yield f"  positions are relative to ({place}) in the frame of the given poses"
    if facts["lenses"]:
        yield f"lenses: {facts['lenses']}"
    yield from _sureness(facts)
    yield from _groups(facts["groups"])
    unused = facts["left_out"] + facts["skipped"]
    if unused:
        yield f"left out ({len(unused)}):"
    for entry in unused[:_LISTED]:
        yield f"  {entry['name']}: {entry['reason']}"
    if len(unused) > _LISTED:
        yield f"  and {len(unused) - _LISTED} more: --json lists all, or ask with a photo's name"
    if facts["weakest"]:
        yield "weakest cameras (against the median camera):"
        for camera in facts["weakest"]:
            yield (
                f"  {camera['name']}: {camera['because']} ({camera['weakness']:.1f} times worse); "
                f"{camera['points']} points, {camera['matches']} matches in {camera['pairs']} pairs, "
                f"{camera['error_px']:.2f} px"
            )
    if facts["cut_pairs"]:
        shown = "; ".join(f"{first} with {second}" for first, second in facts["cut_pairs"][:_LISTED])
        yield f"held together by one pair alone ({len(facts['cut_pairs'])}): {shown}"


def photo_lines(facts: dict[str, Any]) -> Iterator[str]:
    if facts["role"] is None:
        yield f"{facts['name']}: could not be used: {facts['reason']}"
        return
    yield f"{facts['name']}: {'placed' if facts['placed'] else 'not placed'}, {facts['role']} view"
    if facts["reason"]:
        yield f"  {facts['reason']}"
    if facts.get("group"):
        yield f"  group: {facts['group']}"
    if facts["placed"]:
        yield from _pose(facts)
    if facts.get("features") is not None:
        yield f"  {facts['features']} features" + (f", {facts['points']} points in space" if facts["placed"] else "")
    if facts["role"] == "test":
        measured = "not measured" if facts["psnr"] is None else f"{facts['psnr']:.2f} dB"
        yield f"  held out from training: {measured}"
    yield from _pairs(facts["pairs"])


def _sureness(facts: dict[str, Any]) -> Iterator[str]:
    agreed = facts["agreement"]
    if agreed is not None:
        yield (
            f"compared with {agreed['with']} over {agreed['common']} photos: pairwise rotations differ by "
            f"{agreed['rotation_median_deg']:.2f}° (median) and {agreed['rotation_p99_deg']:.2f}° (99 %), positions by "
            f"at most {100 * agreed['largest_shift']:.2f} % of the scene"
        )
    if facts["contradicted_share"] is not None:
        yield f"{100 * facts['contradicted_share']:.1f} % of the verified matches contradict the poses"


def _groups(groups: list[dict[str, Any]]) -> Iterator[str]:
    if len(groups) < 2:
        return
    yield f"{len(groups)} groups of photos without common features:"
    for k, group in enumerate(groups):
        yield f"  {group['name']}: {len(group['photos'])} photos{', the one that is kept' if k == 0 else ''}"
        if group["bridge"] is not None:
            yield f"    to join it: {group['bridge']['advice']}"


def _pose(facts: dict[str, Any]) -> Iterator[str]:
    unit = " m" if facts["metric"] else ""
    center, direction = (", ".join(f"{v:.3f}" for v in facts[key]) for key in ("center", "direction"))
    yield f"  at ({center}){unit}, looking along ({direction}); focal length {facts['focal_px']:.0f} px"
    if facts.get("error_px") is not None:
        yield f"  reprojection error {facts['error_px']:.2f} px"
    if "importance" in facts and facts["role"] == "training":
        target = f"; made consistent with {facts['target']}" if facts["target"] else ""
        yield f"  importance {facts['importance']:.4f}, rank {facts['importance_rank']}{target}"


def _pairs(pairs: list[dict[str, Any]]) -> Iterator[str]:
    verified = [pair for pair in pairs if pair["inliers"]]
    failed = [pair for pair in pairs if not pair["inliers"]]
    yield f"  {len(verified)} of {len(pairs)} pairs tried are verified:"
    for pair in verified[:_LISTED]:
        note = ""
        if pair["contradicted"]:
            note = f", {pair['contradicted']} contradict the poses"
        yield f"    {pair['name']}: {pair['inliers']} matches ({', '.join(pair['why'])}){note}"
    if len(verified) > _LISTED:
        yield f"    and {len(verified) - _LISTED} more"
    if failed:
        best = ", ".join(f"{pair['name']} ({pair['matches']})" for pair in failed[:5])
        yield f"  not verified: {len(failed)}; features matched without a common geometry: {best}"
