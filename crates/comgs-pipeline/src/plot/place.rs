//! Where labels go: beside their points, off the markers and off one another.

use super::svg::P;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rect {
    pub x: f64,
    pub y: f64,
    pub w: f64,
    pub h: f64,
}

impl Rect {
    pub fn around(center: P, half_width: f64, half_height: f64) -> Self {
        Self {
            x: center.0 - half_width,
            y: center.1 - half_height,
            w: 2.0 * half_width,
            h: 2.0 * half_height,
        }
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.x < other.x + other.w
            && other.x < self.x + self.w
            && self.y < other.y + other.h
            && other.y < self.y + self.h
    }

    fn inside(&self, outer: &Self) -> bool {
        self.x >= outer.x
            && self.y >= outer.y
            && self.x + self.w <= outer.x + outer.w
            && self.y + self.h <= outer.y + outer.h
    }

    /// Whether a segment passes through (Liang and Barsky 1984).
    fn crossed(&self, (a, b): (P, P)) -> bool {
        let (mut enter, mut leave) = (0.0f64, 1.0f64);
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        for (slope, distance) in [
            (-dx, a.0 - self.x),
            (dx, self.x + self.w - a.0),
            (-dy, a.1 - self.y),
            (dy, self.y + self.h - a.1),
        ] {
            if slope == 0.0 {
                if distance < 0.0 {
                    return false;
                }
            } else if slope < 0.0 {
                enter = enter.max(distance / slope);
            } else {
                leave = leave.min(distance / slope);
            }
        }
        enter < leave
    }

    fn nearest(&self, p: P) -> P {
        (p.0.clamp(self.x, self.x + self.w), p.1.clamp(self.y, self.y + self.h))
    }
}

/// A label that wants a place beside a marker.
pub(super) struct Wanted {
    pub at: P,
    /// Radius of the marker.
    pub radius: f64,
    /// Size of the text.
    pub size: (f64, f64),
}

pub(super) struct Placed {
    pub rect: Rect,
    /// A thin line from the marker, where the label is not next to it.
    pub leader: Option<(P, P)>,
}

/// Pixels between a marker's rim and its label, from near to far.
const GAPS: [f64; 7] = [3.0, 8.0, 15.0, 24.0, 35.0, 48.0, 64.0];
/// From this gap on a leader is drawn.
const LEADER: f64 = 8.0;
const DIRECTIONS: usize = 32;
/// Points nearer to one another than this, in pixels, are a crowd.
const CROWD: f64 = 24.0;
/// A label may lie on a line (it has a rim), but had better go as many pixels further off.
const CROSSING: f64 = 12.0;
/// A line that passes a label this close, in pixels, counts as behind it.
const AIR: f64 = 2.0;
/// Right of the point is read first, above next; the last is straight down or to the left.
const DIRECTION: f64 = 3.0;

/// Places labels; `None` where there is no room.
///
/// No label leaves `area`, covers one of the `markers` or another label; lines (`segments`) may pass behind. Labels are
/// placed one after the other, the important ones first, each at its cheapest free spot. Where that leaves some without
/// a place, labels of crowded points are sent further out, where a circle has room for more; of these attempts the
/// first that places the most is taken.
pub(super) fn place(
    wanted: &[Wanted],
    markers: &[Rect],
    segments: &[(P, P)],
    area: Rect,
) -> Vec<Option<Placed>> {
    let mut best: Vec<Option<Placed>> = Vec::new();
    for nearest in 0..GAPS.len() {
        let placed = attempt(wanted, markers, segments, area, nearest);
        let count = |p: &[Option<Placed>]| p.iter().flatten().count();
        if best.is_empty() || count(&placed) > count(&best) {
            best = placed;
        }
        if best.iter().all(Option::is_some) {
            break;
        }
    }
    best
}

/// One pass of [`place`] with crowded labels no nearer than the gap of index `nearest`.
fn attempt(
    wanted: &[Wanted],
    markers: &[Rect],
    segments: &[(P, P)],
    area: Rect,
    nearest: usize,
) -> Vec<Option<Placed>> {
    let distance = |a: P, b: P| (a.0 - b.0).hypot(a.1 - b.1);
    let mut placed: Vec<Option<Placed>> = Vec::with_capacity(wanted.len());
    let mut lines = segments.to_vec();
    for (i, label) in wanted.iter().enumerate() {
        let crowded = wanted.iter().enumerate().any(|(j, w)| j != i && distance(w.at, label.at) < CROWD);
        let mut best: Option<(f64, Placed)> = None;
        for &gap in &GAPS[if crowded { nearest } else { 0 }..] {
            for direction in 0..DIRECTIONS {
                let angle = std::f64::consts::TAU * direction as f64 / DIRECTIONS as f64;
                let (dx, dy) = (angle.cos(), -angle.sin());
                let reach = label.radius + gap;
                let (half_w, half_h) = (0.5 * label.size.0, 0.5 * label.size.1);
                let center = (
                    label.at.0 + dx * reach + (1.4 * dx).clamp(-1.0, 1.0) * half_w,
                    label.at.1 + dy * reach + (1.4 * dy).clamp(-1.0, 1.0) * half_h,
                );
                let rect = Rect::around(center, half_w, half_h);
                if !rect.inside(&area) || markers.iter().any(|m| rect.overlaps(m)) {
                    continue;
                }
                let leader = (gap >= LEADER).then(|| {
                    let rim = (label.at.0 + dx * label.radius, label.at.1 + dy * label.radius);
                    let end = rect.nearest(rim);
                    (rim, (end.0 - 2.0 * dx, end.1 - 2.0 * dy))
                });
                let others = || placed.iter().flatten();
                if others().any(|o| rect.overlaps(&o.rect))
                    || leader.is_some_and(|l| others().any(|o| o.rect.crossed(l)))
                {
                    continue;
                }
                let aired = Rect::around(center, half_w + AIR, half_h + AIR);
                let behind = lines.iter().filter(|&&l| aired.crossed(l)).count();
                let own = Rect::around(label.at, 1.0, 1.0);
                let foreign = || markers.iter().filter(|m| !m.overlaps(&own));
                let across = leader.map_or(0, |l| foreign().filter(|m| m.crossed(l)).count());
                let cost =
                    gap + CROSSING * (behind + across) as f64 + DIRECTION * ((1.0 - dx) + 0.3 * (1.0 + dy));
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, Placed { rect, leader }));
                }
            }
        }
        let best = best.map(|(_, p)| p);
        lines.extend(best.as_ref().and_then(|p| p.leader));
        placed.push(best);
    }
    placed
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: twenty points on one spot keep their labels apart and inside; where there is no room, none is forced.
    #[test]
    fn labels_stay_apart() {
        let area = Rect { x: 0.0, y: 0.0, w: 400.0, h: 300.0 };
        let crowd = |n: usize| -> Vec<Wanted> {
            (0..n).map(|_| Wanted { at: (200.0, 150.0), radius: 4.0, size: (30.0, 12.0) }).collect()
        };
        let markers = [Rect::around((200.0, 150.0), 4.0, 4.0)];
        let placed: Vec<Placed> = place(&crowd(20), &markers, &[], area).into_iter().flatten().collect();
        assert!(placed.len() >= 15, "{} of 20 found a place", placed.len());
        for (i, a) in placed.iter().enumerate() {
            assert!(a.rect.inside(&area) && !a.rect.overlaps(&markers[0]));
            assert!(placed[..i].iter().all(|b| !a.rect.overlaps(&b.rect)));
        }
        let narrow = Rect { x: 190.0, y: 140.0, w: 20.0, h: 20.0 };
        assert!(place(&crowd(1), &markers, &[], narrow)[0].is_none());
    }

    /// Goal: a free spot without a line behind it is preferred, and a segment beside the box does not cross it.
    #[test]
    fn lines_are_avoided() {
        let area = Rect { x: 0.0, y: 0.0, w: 200.0, h: 200.0 };
        let wanted = [Wanted { at: (100.0, 100.0), radius: 4.0, size: (30.0, 12.0) }];
        let line = ((100.0, 100.0), (200.0, 100.0));
        let free = place(&wanted, &[], &[], area)[0].as_ref().map(|p| p.rect).unwrap();
        assert!(free.crossed(line), "without lines the label goes to the right");
        let off = place(&wanted, &[], &[line], area)[0].as_ref().map(|p| p.rect).unwrap();
        assert!(!off.crossed(line));
        assert!(!free.crossed(((0.0, 0.0), (200.0, 0.0))));
    }
}
