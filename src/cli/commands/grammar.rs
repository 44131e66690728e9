//! The grammar of values on the command line: one parser and one kind of message for each kind of
//! value.
//!
//! ```text
//!  number          600  -1.5e3              whole number    1000
//!  share           1/8  0.125  12.5%        value           600  50%          % of a range
//!  range           300:900  :900  10%:50%   steps           3:8  3:  :8  3    FIRST:LAST
//!  error           2.5  1%                  size            4GiB  500MB  50%
//!  box             10:20,:,5:               triple          1,1,2.5
//!  times           0,0.5,2   0,0.5,...      time span       2d  12h  30m  90s
//!  type            uint16  u16  <f4         shard           3/16
//!  length          0.5  2mm  0.1%          opacity         0.3  30%
//!  volume          5  5mm3
//!  label           7  -1  liver  all
//!  plane           z=40  x=50%          slab            z=40:  x=:50%  y=10:20
//! ```
//!
//! A parser says what it expected, with an example. Before that, clap says what it got, and for
//! which flag.

use super::times::Times;
use isospan::archive::values::Quantiser;
use isospan::exec::MOST_THREADS;
use isospan::formats::raw::SampleType;
pub use isospan::pipeline::FieldValue as Value;
use isospan::pipeline::{Bound, Focus, Length, NanPolicy, Roi, Shard, StepRange};
use isospan::render::{ColourMap, Paint, Up, parse_colour};
use isospan::volume::ScalarType;
use isospan::volume::units::Unit;
use isospan::{Error, Result};
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::time::Duration;

/// What a parser of clap gives.
type Parsed<T> = std::result::Result<T, String>;

/// The message of all parsers.
fn expected<T>(found: Option<T>, what: &str) -> Parsed<T> {
    found.ok_or_else(|| format!("expected {what}"))
}

fn finite(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|v| v.is_finite())
}

fn positive(text: &str) -> Option<f64> {
    finite(text).filter(|v| *v > 0.0)
}

/// A share in percent, as a part of 1.
fn percent(text: &str) -> Option<f64> {
    text.trim().strip_suffix('%').and_then(finite).map(|p| p / 100.0)
}

/// A number: `600`, `-1.5e3`.
pub(crate) fn number(text: &str) -> Parsed<f64> {
    expected(finite(text), "a number, as in 600 or -1.5e3")
}

/// A number above 0: `2.5`.
pub(crate) fn positive_number(text: &str) -> Parsed<f64> {
    expected(positive(text), "a number above 0, as in 2.5")
}

/// A whole number: `1000`.
pub(crate) fn whole<T: TryFrom<u64>>(text: &str) -> Parsed<T> {
    let found = text.trim().parse::<u64>().ok().and_then(|n| T::try_from(n).ok());
    expected(found, "a whole number, as in 1000")
}

/// A whole number within bounds.
pub(crate) fn whole_in<T>(
    bounds: RangeInclusive<T>,
) -> impl Fn(&str) -> Parsed<T> + Clone + Send + Sync + 'static
where
    T: TryFrom<u64> + PartialOrd + Display + Clone + Send + Sync + 'static,
{
    move |text| {
        let found = whole(text).ok().filter(|n| bounds.contains(n));
        expected(found, &format!("a whole number from {} to {}", bounds.start(), bounds.end()))
    }
}

/// A label, or all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum LabelChoice {
    /// That of a number.
    One(i64),
    /// That of a name.
    Named(String),
    /// All but 0.
    All,
}

/// A label: `7`, `-1`, a name, or `all`.
pub(crate) fn label(text: &str) -> Parsed<LabelChoice> {
    let found = match text.trim() {
        "all" => Some(LabelChoice::All),
        name if !name.contains(char::is_alphanumeric) => None,
        name => Some(name.parse().map_or_else(|_| LabelChoice::Named(name.into()), LabelChoice::One)),
    };
    expected(found, "a label, as in 7, its name, or all")
}

/// Threads: `8`, or 0 for as many as the process may use.
pub(crate) fn threads(text: &str) -> Parsed<usize> {
    whole_in(0..=MOST_THREADS)(text)
}

/// A whole number above 0: `1000`, `250k`, `1.5M`.
pub(crate) fn natural(text: &str) -> Parsed<u64> {
    let text = text.trim();
    let found = match text.chars().last().and_then(|unit| Some((unit, "kMG".find(unit)?))) {
        None => whole(text).ok(),
        Some((unit, n)) => {
            let many = text.strip_suffix(unit).and_then(positive).map(|x| x * 1000f64.powi(n as i32 + 1));
            // A decimal fraction times a thousand is whole but for rounding.
            let is_whole = |x: &f64| (x - x.round()).abs() <= 1e-9 * x && *x < 1e15;
            many.filter(is_whole).map(|x| x.round() as u64)
        }
    };
    expected(found.filter(|n| *n > 0), "a whole number above 0, as in 4, 250k or 1.5M")
}

/// A share above 0: `1/8`, `0.125`, `12.5%`, `1`.
pub fn share(text: &str) -> Parsed<f64> {
    let value = match text.split_once('/') {
        Some((a, b)) => positive(a).zip(positive(b)).map(|(a, b)| a / b),
        None => percent(text).or_else(|| finite(text)),
    };
    expected(value.filter(|v| *v > 0.0 && *v <= 64.0), "a share, as in 1/8, 0.125 or 12.5%")
}

/// An error: `2.5` in units of the field, or `1%` of its range.
pub fn error(text: &str) -> Parsed<Bound> {
    let share = percent(text).map(Bound::OfRange);
    let found = share.or_else(|| finite(text).map(Bound::Value));
    let above_0 = |bound: &Bound| matches!(bound, Bound::OfRange(v) | Bound::Value(v) if *v > 0.0);
    expected(found.filter(above_0), "an error above 0, as in 2.5 or 1%")
}

/// A length: `0.5` in world units, `0.2mm`, or `0.1%` of the diagonal of the domain.
pub(crate) fn length(text: &str) -> Parsed<Length> {
    let found = match percent(text) {
        Some(share) => Some(share).filter(|share| *share > 0.0).map(Length::OfDiagonal),
        None => positive(text).map(Length::World).or_else(|| length_of_a_unit(text.trim())),
    };
    expected(found, "a length above 0, as in 0.5 or 0.2mm, or a share of the domain's diagonal, as in 0.1%")
}

/// A volume in world units, or in cubes of a unit of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Volume {
    number: f64,
    /// The edge of the cubes; none for world units.
    edge: Option<Length>,
}

impl Volume {
    /// The volume in world units, of which a length is in `unit`.
    pub(crate) fn in_world(self, unit: Option<&Unit>) -> isospan::Result<f64> {
        let Some(edge) = self.edge else { return Ok(self.number) };
        let edge = edge.in_world(unit, None).map_err(|_| {
            Error::usage(
                "the unit of lengths in the world is not known: give the volume in world units, as in 5, or \
                 name the unit with --length-unit as the archive is made",
            )
        })?;
        Ok(self.number * edge.powi(3))
    }
}

/// A volume: `5` in world units, or `5mm3`.
pub(crate) fn volume(text: &str) -> Parsed<Volume> {
    let text = text.trim();
    let in_cubes = || {
        let text = text.strip_suffix("^3").or_else(|| text.strip_suffix(['3', '³']))?;
        let (number, unit) = number_and_unit(text)?;
        Some(Volume { number, edge: Some(Length::of(1.0, &unit)?) })
    };
    let found = finite(text).map(|number| Volume { number, edge: None }).or_else(in_cubes);
    expected(found.filter(|v| v.number >= 0.0), "a volume of 0 or more, as in 5 or 5mm3")
}

fn length_of_a_unit(text: &str) -> Option<Length> {
    let (number, unit) = number_and_unit(text)?;
    Length::of(Some(number).filter(|n| *n > 0.0)?, &unit)
}

/// A number, and a unit of length behind it.
fn number_and_unit(text: &str) -> Option<(f64, Unit)> {
    let is_of_number = |c: char| c.is_ascii_digit() || ".+-".contains(c);
    // An exponent ends with a digit, too.
    let (end, last) = text.char_indices().rev().find(|(_, c)| is_of_number(*c))?;
    let (number, unit) = text.split_at(end + last.len_utf8());
    Some((finite(number)?, Unit::length(unit)?))
}

fn value_of(text: &str) -> Option<Value> {
    percent(text).map(Value::Share).or_else(|| finite(text).map(Value::At))
}

/// A value of the field: `600`, or `50%` of the way from the least value to the largest.
pub fn value(text: &str) -> Parsed<Value> {
    let is_inside = |value: &Value| match value {
        Value::At(_) => true,
        Value::Share(share) => (0.0..=1.0).contains(share),
    };
    expected(
        value_of(text).filter(is_inside),
        "a value, as in 600, or a place in the range from 0% to 100%, as in 50%",
    )
}

/// Values from one to another; an end that is not given is open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Range {
    low: Option<Value>,
    high: Option<Value>,
}

impl Range {
    /// The values that matter. An open end is infinite, and refused with the others.
    pub(crate) fn focus(self) -> Focus {
        let end = |end: Option<Value>, open| end.unwrap_or(Value::At(open));
        Focus { low: end(self.low, f64::NEG_INFINITY), high: end(self.high, f64::INFINITY) }
    }

    /// Whether an end is a share of the range of the field.
    pub(crate) fn is_of_a_range(self) -> bool {
        [self.low, self.high].into_iter().flatten().any(|end| matches!(end, Value::Share(_)))
    }

    /// The values; open ends are infinite.
    ///
    /// # Errors
    /// [`Error::Usage`] for ends in the wrong order, and as [`Value::of`].
    pub(crate) fn of(self, values: Option<[f64; 2]>) -> Result<[f64; 2]> {
        let end = |end: Option<Value>, open| end.map_or(Ok(open), |value| value.of(values));
        let [low, high] = [end(self.low, f64::NEG_INFINITY)?, end(self.high, f64::INFINITY)?];
        if low > high {
            return Err(Error::usage(format!("the range {low}:{high} is empty: write the lower end first")));
        }
        Ok([low, high])
    }

    /// The values; open ends are those of the field, 0 and 1 where it has none.
    ///
    /// # Errors
    /// As [`Range::of`]; [`Error::Usage`] where an end lies beyond the field's, and the other one
    /// is open.
    pub(crate) fn within(self, values: Option<[f64; 2]>) -> Result<[f64; 2]> {
        let ([least, most], [low, high]) = (values.unwrap_or([0.0, 1.0]), self.of(values)?);
        let range = [if low.is_finite() { low } else { least }, if high.is_finite() { high } else { most }];
        if range[0] > range[1] {
            let [low, high] = range;
            return Err(Error::usage(format!(
                "the range {low}:{high} is empty: the field has {least} to {most}"
            )));
        }
        Ok(range)
    }
}

/// A range of values: `300:900`, `300:`, `10%:50%`.
pub(crate) fn range(text: &str) -> Parsed<Range> {
    let end = |s: &str| if s.trim().is_empty() { Some(None) } else { value_of(s).map(Some) };
    let found = text.split_once(':').and_then(|(low, high)| Some(Range { low: end(low)?, high: end(high)? }));
    let in_order = |r: &Range| match (r.low, r.high) {
        (Some(Value::At(low)), Some(Value::At(high)))
        | (Some(Value::Share(low)), Some(Value::Share(high))) => low <= high,
        _ => true,
    };
    expected(found.filter(in_order), "a range LO:HI with LO <= HI, as in 300:900, 300: or 10%:50%")
}

/// A plane across an axis of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plane {
    pub(crate) axis: usize,
    pub(crate) at: Value,
}

/// What lies between two planes across an axis of the world; an end may be open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slab {
    pub(crate) axis: usize,
    pub(crate) range: Range,
}

/// The names of the axes of the world.
pub(crate) const AXES: [&str; 3] = ["x", "y", "z"];

/// An axis, and what stands behind its `=`.
fn on_axis(text: &str) -> Option<(usize, &str)> {
    let (name, rest) = text.split_once('=')?;
    Some((AXES.iter().position(|a| *a == name.trim())?, rest))
}

/// A plane: `z=40` in world units, or `z=50%` of the domain.
pub(crate) fn plane(text: &str) -> Parsed<Plane> {
    let found = on_axis(text).and_then(|(axis, at)| Some(Plane { axis, at: value_of(at)? }));
    expected(found, "a plane, as in z=40 in world units, or x=50% of the domain")
}

/// A slab: `z=40:`, `x=:50%`, `y=10:20`.
pub(crate) fn slab(text: &str) -> Parsed<Slab> {
    let found = on_axis(text).and_then(|(axis, ends)| Some(Slab { axis, range: range(ends).ok()? }));
    expected(found, "an axis and a range, as in z=40: for all from 40 on, x=:50% or y=10:20")
}

/// An opacity: `0.3`, `30%`.
pub(crate) fn opacity(text: &str) -> Parsed<f32> {
    let found = percent(text).or_else(|| finite(text)).map(|v| v as f32);
    expected(found.filter(|v| *v > 0.0 && *v <= 1.0), "an opacity above 0 and at most 1, as in 0.3 or 30%")
}

/// A name of a colour map.
pub(crate) fn colour_map(text: &str) -> Parsed<ColourMap> {
    let names = ColourMap::ALL.map(ColourMap::name).join(", ");
    expected(text.parse().ok(), &format!("a colour map: {names}"))
}

const NO_UNIT: &str = "the name of a unit, as in K or mm";

/// `K`.
pub(crate) fn unit(text: &str) -> Parsed<Unit> {
    expected(Unit::new(text), NO_UNIT)
}

/// `mm`.
pub(crate) fn length_unit(text: &str) -> Parsed<Unit> {
    expected(Unit::length(text), NO_UNIT)
}

/// `s`.
pub(crate) fn time_unit(text: &str) -> Parsed<Unit> {
    expected(Unit::time(text), NO_UNIT)
}

/// A number of pictures in a second: `15`, `0.5`.
pub(crate) fn frame_rate(text: &str) -> Parsed<f64> {
    expected(finite(text).filter(|v| (0.1..=50.0).contains(v)), "a number from 0.1 to 50, as in 15")
}

/// Steps by number: `3:8`, `3:`, `:8`, `3`.
pub(crate) fn steps(text: &str) -> Parsed<StepRange> {
    expected(text.parse().ok(), "steps FIRST:LAST, as in 3:8 or 3:")
}

/// A box: `10:20,:,5:`, `world:-1:1,:,:`.
pub(crate) fn region(text: &str) -> Parsed<Roi> {
    let what =
        "a box I0:I1,J0:J1,K0:K1 in numbers of samples, or world:X0:X1,Y0:Y1,Z0:Z1; ends may be left out";
    expected(text.parse().ok(), what)
}

/// Times: `0,0.5,2`, or `0,0.5,...`, which goes on like that.
pub(crate) fn times(text: &str) -> Parsed<Times> {
    let (list, goes_on) = match text.strip_suffix(",...") {
        Some(list) => (list, true),
        None => (text, false),
    };
    let list: Option<Vec<f64>> = list.split(',').map(finite).collect();
    let found = match list.as_deref() {
        Some(&[start, next]) if goes_on => Some(Times::Regular { start, step: next - start }),
        Some(list) if !goes_on => Some(Times::List(list.to_vec())),
        _ => None,
    };
    expected(found, "times, as in 0,0.5,2, or 0,0.5,... which goes on like that")
}

/// Three numbers: `1,1,2.5`.
pub(crate) fn triple(text: &str) -> Parsed<[f64; 3]> {
    expected(list(text, finite), "three numbers X,Y,Z, as in 1,1,2.5")
}

/// Three whole numbers: `256,256,128`.
pub(crate) fn whole_triple<T: TryFrom<u64>>(text: &str) -> Parsed<[T; 3]> {
    expected(list(text, |s| whole(s).ok()), "three whole numbers X,Y,Z, as in 256,256,128")
}

/// A width and a height: `800,600`.
pub(crate) fn extent(text: &str) -> Parsed<[u32; 2]> {
    expected(list(text, |s| whole(s).ok()), "two whole numbers W,H, as in 800,600")
}

/// Numbers between commas, or between the x of `256x256x128`.
fn list<T, const N: usize>(text: &str, number: impl Fn(&str) -> Option<T>) -> Option<[T; N]> {
    let all: Option<Vec<T>> = text.split([',', 'x']).map(number).collect();
    all?.try_into().ok()
}

/// Bytes: `4GiB`, `500MB`, `1048576`.
fn bytes_of(text: &str) -> Option<u64> {
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kib" => 1024.0,
        "kb" => 1e3,
        "m" | "mib" => 1_048_576.0,
        "mb" => 1e6,
        "g" | "gib" => 1_073_741_824.0,
        "gb" => 1e9,
        "t" | "tib" => 1_099_511_627_776.0,
        "tb" => 1e12,
        _ => return None,
    };
    let bytes = number.parse::<f64>().ok()? * factor;
    (1.0..1e18).contains(&bytes).then_some(bytes as u64)
}

/// Memory: `4GiB`, `500MB`, or `50%` of what the process may use.
pub fn memory(text: &str) -> Parsed<u64> {
    let of_all = |share: f64| (share * isospan::exec::usable_memory() as f64) as u64;
    let share = percent(text).filter(|share| *share > 0.0 && *share <= 1.0).map(of_all);
    expected(share.or_else(|| bytes_of(text)), "an amount of memory, as in 4GiB, 500MB or 50%")
}

/// How large an archive may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Size {
    Bytes(u64),
    /// A share of the bytes of the source.
    OfSource(f64),
}

/// A size: `50MiB`, or `5%` or `1/20` of the source.
pub(crate) fn size(text: &str) -> Parsed<Size> {
    let is_share = text.contains(['%', '/']);
    // Nobody means so few bytes.
    if let Some(number) = finite(text).filter(|n| *n > 0.0 && *n < 1024.0) {
        return Err(format!("expected a unit: {number}MiB, or {number}% of the source"));
    }
    let found = match is_share {
        true => share(text).ok().filter(|share| *share <= 1.0).map(Size::OfSource),
        false => bytes_of(text).map(Size::Bytes),
    };
    expected(found, "a size, as in 50MiB, or a share of the source, as in 5% or 1/20")
}

/// A time span: `2d`, `12h`, `30m`, `90s`.
pub(crate) fn span(text: &str) -> Parsed<Duration> {
    let seconds = |unit: &str| match unit {
        "s" => Some(1),
        "m" => Some(60),
        "h" => Some(3600),
        "d" => Some(86_400),
        _ => None,
    };
    let found = text
        .split_at_checked(text.len().saturating_sub(1))
        .and_then(|(number, unit)| Some(u64::from(number.parse::<u32>().ok()?) * seconds(unit)?));
    expected(found.map(Duration::from_secs), "a time span, as in 2d, 12h, 30m or 90s")
}

/// The type of a sample, as NumPy names it: `uint16`, `<u2`, `>f4`.
pub(crate) fn sample_type(text: &str) -> Parsed<SampleType> {
    let names = ScalarType::ALL.map(ScalarType::name).join(" ");
    expected(
        SampleType::from_name(text),
        &format!("a type, as in uint16, u16 or '<f4'; the types are {names}"),
    )
}

/// `3/16`.
pub(crate) fn shard(text: &str) -> Parsed<Shard> {
    expected(text.parse().ok(), "a shard I/N with I below N, as in 3/16")
}

/// A number of bits.
pub(crate) fn bits(text: &str) -> Parsed<f64> {
    let found = number(text).ok().filter(|n| Quantiser::BITS.contains(n));
    expected(found, "a number of bits from 4 to 24")
}

/// `error`, `mask`, or a value.
pub(crate) fn nan(text: &str) -> Parsed<NanPolicy> {
    expected(NanPolicy::parse(text), "error, mask, or a number")
}

/// `z`, `-y`.
pub(crate) fn up(text: &str) -> Parsed<Up> {
    expected(text.parse().ok(), "an axis: x, y, z, -x, -y or -z")
}

/// `#d8cbb4`, or `normals`.
pub(crate) fn paint(text: &str) -> Parsed<Paint> {
    let found = match text {
        "normals" => Some(Paint::Normals),
        colour => parse_colour(colour).ok().map(Paint::Plain),
    };
    expected(found, "a colour, as in #d8cbb4, or normals")
}

/// `#ffffff`, or `transparent`.
pub(crate) fn background(text: &str) -> Parsed<[u8; 4]> {
    let found = match text {
        "transparent" => Some([255, 255, 255, 0]),
        colour => parse_colour(colour).ok().map(|[r, g, b]| [r, g, b, 255]),
    };
    expected(found, "a colour, as in #ffffff, or transparent")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused<T: std::fmt::Debug>(parse: impl Fn(&str) -> Parsed<T>, texts: &[&str]) {
        for text in texts {
            let message = parse(text).unwrap_err();
            assert!(message.starts_with("expected "), "{text}: {message}");
        }
    }

    #[test]
    fn numbers() {
        assert_eq!((number("-1.5e3"), positive_number("2")), (Ok(-1500.0), Ok(2.0)));
        assert_eq!((whole::<u32>("77"), natural("1")), (Ok(77), Ok(1)));
        assert_eq!(
            [natural("250k"), natural("1.5M"), natural("2G")],
            [Ok(250_000), Ok(1_500_000), Ok(2_000_000_000)]
        );
        assert_eq!(whole_in(2..=5u32)("5"), Ok(5));
        refused(number, &["", "x", "nan", "inf", "1,5"]);
        refused(positive_number, &["0", "-1"]);
        refused(whole::<u8>, &["", "-1", "1.5", "256"]);
        refused(natural, &["0", "0k", "-1M", "1.5", "k", "1.0001k", "1m", "1kk"]);
        assert_eq!((threads("0"), threads("4096")), (Ok(0), Ok(4096)));
        refused(threads, &["", "-1", "4097", "18446744073709551615", "18446744073709551616"]);
        refused(whole_in(2..=5u32), &["1", "6"]);
    }

    #[test]
    fn shares_and_errors() {
        assert_eq!(["1/8", "0.5", "12.5%"].map(share), [Ok(0.125), Ok(0.5), Ok(0.125)]);
        refused(share, &["%", "1/8%", "0%", "6401%", "0", "-1/8", "1/0", "x", "1/", "nan", "1000"]);
        assert_eq!((error("2.5"), error("1%")), (Ok(Bound::Value(2.5)), Ok(Bound::OfRange(0.01))));
        refused(error, &["", "0", "-1%", "0%", "x"]);
        assert_eq!((length("2.5"), length("1%")), (Ok(Length::World(2.5)), Ok(Length::OfDiagonal(0.01))));
        let millimetres = |value| Length::of(value, &Unit::length("mm").unwrap()).unwrap();
        assert_eq!((length("0.2mm"), length(" 1e3 mm")), (Ok(millimetres(0.2)), Ok(millimetres(1e3))));
        refused(length, &["", "0", "-1", "0%", "x", "0mm", "mm", "1 mm 2", "5px"]);
        let of = |number, edge: Option<&str>| {
            Ok(Volume {
                number,
                edge: edge.map(|name| Length::of(1.0, &Unit::length(name).unwrap()).unwrap()),
            })
        };
        assert_eq!(
            (volume("2.5e3"), volume("0"), volume("5mm3")),
            (of(2500.0, None), of(0.0, None), of(5.0, Some("mm")))
        );
        assert_eq!((volume("0.5 um^3"), volume("5 µm³")), (of(0.5, Some("um")), of(5.0, Some("um"))));
        assert_eq!(volume("5mm3").unwrap().in_world(Unit::length("um").as_ref()).unwrap(), 5e9);
        assert!(volume("5mm3").unwrap().in_world(None).is_err());
        refused(volume, &["", "-1", "x", "5mm", "5mm2", "mm3", "5px3", "1%", "-1mm3"]);
    }

    #[test]
    fn values_and_ranges() {
        let range_of = |text: &str| range(text).unwrap().of(Some([100.0, 300.0])).unwrap();
        assert_eq!(value("50%").unwrap().of(Some([100.0, 300.0])).unwrap(), 200.0);
        assert_eq!(value("-7").unwrap().of(None).unwrap(), -7.0);
        assert_eq!(value("10%").unwrap().of(Some([0.0, 0.7])).unwrap(), 0.07, "as short as can be");
        assert!(value("10%").unwrap().of(None).is_err());
        let offset = value("50%").unwrap().of(Some([101_325_000.0, 101_325_003.0])).unwrap();
        assert_eq!(offset, 101_325_001.5, "no f32");
        assert_eq!((range_of("-1.5:2"), range_of("10%:50%")), ([-1.5, 2.0], [120.0, 200.0]));
        assert_eq!(
            (range_of("3:"), range_of(":")),
            ([3.0, f64::INFINITY], [f64::NEG_INFINITY, f64::INFINITY])
        );
        assert!(range("250:50%").unwrap().of(Some([100.0, 300.0])).is_err());
        refused(range, &["", "3", "2:1", "50%:10%", "a:b", "nan:", "inf:", "1:2:3"]);
        refused(value, &["", "x", "%", "1%%", "150%", "-1%"]);
    }

    #[test]
    fn planes_and_slabs() {
        let of = |text: &str| plane(text).map(|p| (p.axis, p.at.of(Some([10.0, 30.0])).unwrap()));
        assert_eq!((of("z=-4.5"), of("x=50%")), (Ok((2, -4.5)), Ok((0, 20.0))));
        refused(plane, &["", "z", "z=", "w=1", "z=1:2", "=1", "z=nan"]);
        let of = |text: &str| slab(text).map(|s| (s.axis, s.range.of(Some([10.0, 30.0])).unwrap()));
        assert_eq!((of("y=10%:20"), of("z=:4")), (Ok((1, [12.0, 20.0])), Ok((2, [f64::NEG_INFINITY, 4.0]))));
        refused(slab, &["", "z=4", "z=2:1", "w=1:", "1:2"]);
        assert_eq!((opacity("30%"), opacity("1")), (Ok(0.3), Ok(1.0)));
        refused(opacity, &["", "0", "1.1", "-1", "101%", "nan"]);
        refused(colour_map, &["", "jet"]);
        refused(frame_rate, &["", "0", "51", "x"]);
    }

    #[test]
    fn steps_and_times() {
        assert_eq!(steps("3:8"), Ok(StepRange { first: Some(3), last: Some(8) }));
        refused(steps, &["", "8:3", "a"]);
        assert_eq!(times("0, 0.5,-2e1"), Ok(Times::List(vec![0.0, 0.5, -20.0])));
        assert_eq!(times("10,10.5,..."), Ok(Times::Regular { start: 10.0, step: 0.5 }));
        refused(times, &["", "a", "1,,2", "1:2", "nan", "1,...", "1,2,3,...", "1..."]);
        assert_eq!((span("2d"), span("0s")), (Ok(Duration::from_secs(172_800)), Ok(Duration::ZERO)));
        refused(span, &["", "d", "2", "-1h", "2 d", "1.5h", "2µ", "9999999999d"]);
    }

    #[test]
    fn triples_boxes_and_shards() {
        assert_eq!((whole_triple("1,2,3"), triple("1x2x3")), (Ok([1u64, 2, 3]), Ok([1.0, 2.0, 3.0])));
        refused(triple, &["1,2", "1,2,3,4", "a,2,3", "1,2,", "", "1,2,inf"]);
        refused(whole_triple::<u32>, &["1,2,-3", "1.5,2,3"]);
        assert_eq!(extent("800x600"), Ok([800, 600]));
        refused(extent, &["800", "1,2,3", "a,b"]);
        assert!(region("world:0:1,:,:").is_ok() && shard("3/16").is_ok());
        refused(region, &["", "1:2", "a:b,:,:"]);
        refused(shard, &["", "3", "16/16", "a/b"]);
    }

    #[test]
    fn sizes() {
        assert_eq!((memory("4GiB"), memory("500MB")), (Ok(4 << 30), Ok(500_000_000)));
        assert_eq!((memory("1.5k"), memory("77")), (Ok(1536), Ok(77)));
        assert!(memory("50%").unwrap() > 1 << 20);
        refused(memory, &["", "GiB", "-1", "3 parsecs", "101%", "0", "0%", "1e30TB"]);
        assert_eq!((size("50MiB"), size("5%")), (Ok(Size::Bytes(50 << 20)), Ok(Size::OfSource(0.05))));
        assert_eq!(size("1/20"), Ok(Size::OfSource(0.05)));
        assert_eq!((size("1024"), size("5B")), (Ok(Size::Bytes(1024)), Ok(Size::Bytes(5))));
        assert_eq!(size("5").unwrap_err(), "expected a unit: 5MiB, or 5% of the source");
        refused(size, &["", "0", "200%", "0%", "x", "1023"]);
    }

    #[test]
    fn words() {
        assert_eq!(bits("6.5"), Ok(6.5));
        refused(bits, &["3", "25", "exact", "x", ""]);
        refused(nan, &["", "hole", "inf"]);
        refused(up, &["", "w", "+x"]);
        refused(paint, &["", "red", "#12"]);
        refused(background, &["", "none"]);
        assert_eq!(["u16", "uint16", "ushort"].map(|name| sample_type(name).is_ok()), [true; 3]);
        refused(sample_type, &["", "char", "long", "<u3", "complex64"]);
    }
}
