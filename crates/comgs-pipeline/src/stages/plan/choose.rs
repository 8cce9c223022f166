//! The choice among effects and presets.

use super::effects::{EFFECTS, Effect};
use super::{Limits, Line};
use comgs_inverse::Quality;

/// The finest preset whose estimate fits, of presets in the order of their cost; the cheapest when none does.
pub(super) fn quality(estimates: &[(Quality, f64)], budget_s: f64) -> Quality {
    let fits = estimates.iter().rev().find(|(_, seconds)| *seconds <= budget_s);
    fits.or(estimates.first()).map_or(Quality::Balanced, |(quality, _)| *quality)
}

/// Decides; returns what cannot be met.
pub(super) fn choose(lines: &mut [Line], always_s: f64, limits: &Limits) -> Option<String> {
    let of = |name: &str| EFFECTS.iter().find(|e| e.name == name);
    for line in lines.iter_mut() {
        let Some(change) = line.change else { continue };
        line.on = change.mean >= limits.tolerance;
        line.reason = if line.on {
            format!("changes {:.2} % of the pixels by {:.4}", 100.0 * change.touched, change.mean)
        } else {
            format!("changes {:.4}, below the tolerance of {}", change.mean, limits.tolerance)
        };
    }
    // An effect falls with what it builds on.
    let drop_orphans = |lines: &mut [Line]| {
        for i in 0..lines.len() {
            let Some(needs) = of(&lines[i].effect).and_then(|e: &Effect| e.needs) else { continue };
            let is_there = lines.iter().any(|l| l.effect == needs && l.on);
            if lines[i].on && !is_there {
                lines[i].on = false;
                lines[i].reason = format!("{needs} does not run");
            }
        }
    };
    drop_orphans(lines);
    let budget = limits.budget_s?;
    let mut spent = always_s;
    // Most change a second first, and an effect never before what it builds on.
    let mut open: Vec<usize> = (0..lines.len()).filter(|&i| lines[i].on).collect();
    for line in lines.iter_mut() {
        line.on = false;
    }
    let worth = |l: &Line| l.change.map_or(0.0, |c| c.mean * c.touched) / l.seconds.max(1e-3);
    while !open.is_empty() {
        let ready = |i: &&usize| {
            let needs = of(&lines[**i].effect).and_then(|e| e.needs);
            needs.is_none_or(|n| !open.iter().any(|&k| lines[k].effect == n))
        };
        let Some(&best) = open
            .iter()
            .filter(ready)
            .max_by(|&&a, &&b| worth(&lines[a]).total_cmp(&worth(&lines[b])).then(b.cmp(&a)))
        else {
            break;
        };
        open.retain(|&i| i != best);
        let needs = of(&lines[best].effect).and_then(|e| e.needs);
        let supported = needs.is_none_or(|n| lines.iter().any(|l| l.effect == n && l.on));
        if supported && spent + lines[best].seconds <= budget {
            spent += lines[best].seconds;
            lines[best].on = true;
        } else if supported {
            lines[best].reason =
                format!("{:.1} s more would exceed the budget of {budget:.1} s", lines[best].seconds);
        } else {
            lines[best].reason = format!("{} does not run", needs.unwrap_or("what it builds on"));
        }
    }
    (always_s > budget).then(|| {
        format!(
            "the budget of {budget:.1} s cannot be met: frames without any effect take {always_s:.1} s; the cheapest \
             plan is made"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Change, effects};
    use super::*;

    fn line(effect: &Effect, mean: f64, seconds: f64) -> Line {
        let change = Some(Change { mean, touched: 0.1 });
        Line { effect: effect.name.into(), change, seconds, on: false, reason: String::new() }
    }

    fn on(lines: &[Line]) -> Vec<&str> {
        lines.iter().filter(|l| l.on).map(|l| l.effect.as_str()).collect()
    }

    /// Goal: what is below the tolerance stays off and so does what builds on it; a budget takes what changes most a second
    /// and never an effect without its ground; a budget that cannot be met gives the cheapest plan and says so.
    #[test]
    fn choices_follow_tolerance_budget_and_order() {
        let all =
            |mean: f64, seconds: f64| EFFECTS.iter().map(|e| line(e, mean, seconds)).collect::<Vec<_>>();
        let limits = |tolerance, budget_s| Limits { tolerance, budget_s, any_quality: false };
        let mut lines = all(0.01, 1.0);
        assert_eq!(choose(&mut lines, 1.0, &limits(0.004, None)), None);
        assert_eq!(on(&lines).len(), EFFECTS.len());
        // Without the near shadow neither the far one nor bounced light makes sense.
        let mut lines = all(0.01, 1.0);
        let near = lines.iter().position(|l| l.effect == effects::SHADOW_NEAR).unwrap();
        lines[near].change = Some(Change { mean: 0.001, touched: 0.1 });
        choose(&mut lines, 1.0, &limits(0.004, None));
        assert!(!on(&lines).contains(&effects::SHADOW_FAR) && !on(&lines).contains(&effects::BOUNCE));
        // Budget for two of them: the most worthwhile that stand alone.
        let mut lines = all(0.01, 1.0);
        lines[near].change = Some(Change { mean: 0.2, touched: 0.3 });
        assert_eq!(choose(&mut lines, 1.0, &limits(0.004, Some(3.0))), None);
        assert_eq!(on(&lines).len(), 2);
        assert!(on(&lines).contains(&effects::SHADOW_NEAR), "{:?}", on(&lines));
        // Nothing fits.
        let mut lines = all(0.01, 1.0);
        let shortfall = choose(&mut lines, 5.0, &limits(0.004, Some(2.0))).unwrap();
        assert!(on(&lines).is_empty() && shortfall.contains("2.0 s cannot be met"), "{shortfall}");
    }

    /// Goal: the finest preset that fits the budget is picked, the cheapest when none does.
    #[test]
    fn a_budget_picks_the_finest_preset_that_fits() {
        let all = [(Quality::Draft, 2.0), (Quality::Balanced, 4.0), (Quality::Reference, 40.0)];
        for (budget, expected) in [
            (1.0, Quality::Draft),
            (2.0, Quality::Draft),
            (39.0, Quality::Balanced),
            (41.0, Quality::Reference),
        ] {
            assert_eq!(quality(&all, budget), expected, "{budget}");
        }
    }
}
