//! Values of arguments: points, pixels, durations.

/// `x,y,z`, three finite numbers.
pub(crate) fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Vec<f64> = text.split(',').map(number).collect::<Result<_, _>>()?;
    <[f64; 3]>::try_from(numbers).map_err(|n| format!("expected three numbers x,y,z, got {}", n.len()))
}

/// A view and a position in it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pixel {
    pub view: String,
    pub x: f64,
    pub y: f64,
}

/// `view,x,y`; a view's name may itself hold commas.
pub(crate) fn pixel(text: &str) -> Result<Pixel, String> {
    let mut parts = text.rsplitn(3, ',');
    let (Some(y), Some(x), Some(view)) = (parts.next(), parts.next(), parts.next()) else {
        return Err("expected view,x,y such as 00003,256,180".into());
    };
    if view.is_empty() {
        return Err("the view's name is empty".into());
    }
    Ok(Pixel { view: view.to_owned(), x: number(x)?, y: number(y)? })
}

/// A pixel of a view that shows a grey card.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GreyCard {
    pub view: String,
    pub x: usize,
    pub y: usize,
    pub albedo: f32,
}

/// `view,x,y` or `view,x,y,albedo`.
pub(crate) fn grey_card(text: &str) -> Result<GreyCard, String> {
    let parts: Vec<&str> = text.split(',').collect();
    let (view, x, y, albedo) = match parts[..] {
        [view, x, y] => (view, x, y, 0.18),
        [view, x, y, albedo] => (view, x, y, number(albedo)? as f32),
        _ => return Err("expected view,x,y or view,x,y,albedo such as 00012,210,140,0.18".into()),
    };
    let pixel = |text: &str| text.trim().parse::<usize>().map_err(|_| format!("{text:?} is not a pixel"));
    if !(albedo > 0.0 && albedo < 1.0) {
        return Err(format!("the card's albedo is {albedo}, expected a number between 0 and 1"));
    }
    Ok(GreyCard { view: view.to_owned(), x: pixel(x)?, y: pixel(y)?, albedo })
}

/// One positive factor, or three.
pub(crate) fn factors(text: &str) -> Result<[f32; 3], String> {
    let numbers: Vec<f64> = text.split(',').map(positive).collect::<Result<_, _>>()?;
    match numbers[..] {
        [s] => Ok([s as f32; 3]),
        [r, g, b] => Ok([r as f32, g as f32, b as f32]),
        _ => Err(format!("expected one factor or three, got {}", numbers.len())),
    }
}

/// A finite number.
pub(crate) fn number(text: &str) -> Result<f64, String> {
    let text = text.trim();
    match text.parse::<f64>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err(format!("{text:?} is not a finite number")),
    }
}

/// A distance in scene units, not negative.
pub(crate) fn distance(text: &str) -> Result<f64, String> {
    let v = number(text)?;
    if v >= 0.0 { Ok(v) } else { Err(format!("{v} is negative")) }
}

/// A positive number of scene units.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let v = number(text)?;
    if v > 0.0 { Ok(v) } else { Err(format!("{v} is not positive")) }
}

/// Seconds of `90`, `90s`, `5m`, `1h`, `1m30s`.
pub(crate) fn duration(text: &str) -> Result<f64, String> {
    let wrong = || format!("{text:?} is not a time such as 90s, 5m or 1h30m");
    if let Ok(seconds) = text.trim().parse::<f64>() {
        return if seconds > 0.0 && seconds.is_finite() { Ok(seconds) } else { Err(wrong()) };
    }
    let mut seconds = 0.0;
    let mut digits = String::new();
    for c in text.trim().chars() {
        let unit = match c {
            '0'..='9' | '.' => {
                digits.push(c);
                continue;
            }
            's' => 1.0,
            'm' => 60.0,
            'h' => 3600.0,
            _ => return Err(wrong()),
        };
        seconds += unit * digits.parse::<f64>().map_err(|_| wrong())?;
        digits.clear();
    }
    if digits.is_empty() && seconds > 0.0 && seconds.is_finite() { Ok(seconds) } else { Err(wrong()) }
}

/// `width x height`, as in 320x180.
pub(crate) fn size(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("{text:?} is not a size such as 320x180");
    let (w, h) = text.split_once(['x', '×']).ok_or_else(wrong)?;
    match (w.trim().parse::<usize>(), h.trim().parse::<usize>()) {
        (Ok(w), Ok(h)) if w > 0 && h > 0 => Ok((w, h)),
        _ => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: what people type is understood, and what cannot be meant is refused with an example.
    #[test]
    fn values() {
        assert_eq!(point("1, -2.5,3e-1"), Ok([1.0, -2.5, 0.3]));
        for bad in ["1,2", "1,2,3,4", "a,b,c", "1,2,NaN", "1,2,inf", ""] {
            assert!(point(bad).is_err(), "{bad}");
        }
        assert_eq!(pixel("00003,256,180.5"), Ok(Pixel { view: "00003".into(), x: 256.0, y: 180.5 }));
        assert_eq!(pixel("a,b,1,2").unwrap().view, "a,b");
        for bad in ["00003,256", "00003", ",1,2", "v,x,2"] {
            assert!(pixel(bad).is_err(), "{bad}");
        }
        for (text, seconds) in [("90", 90.0), ("90s", 90.0), ("5m", 300.0), ("1h30m", 5400.0), ("1.5m", 90.0)]
        {
            assert_eq!(duration(text), Ok(seconds), "{text}");
        }
        for bad in ["", "5 minutes", "-5m", "0", "m", "5m3", "inf", "nan"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
        assert_eq!(size("320x180"), Ok((320, 180)));
        assert!(size("320").is_err() && size("0x3").is_err());
        assert!(positive("0").is_err() && positive("0.3").is_ok());
        assert!(distance("0").is_ok() && distance("-0.1").is_err() && distance("inf").is_err());
        assert_eq!(number("-30.5"), Ok(-30.5));
        assert!(["inf", "-inf", "nan", "thirty"].iter().all(|bad| number(bad).is_err()));
    }
}
