//! The number field of the window: every number that is typed or dragged is one of these.
//!
//! A typed number counts when it is committed, by Enter, Tab or a click elsewhere, and is read by the rules of
//! [`number`](crate::studio::widgets::number). What these refuse leaves the old value as it is, and a sentence says so. Escape ends typing
//! and leaves the old value too. A drag changes the value while it goes on, within the range of the field.

use std::cell::{Cell, RefCell};
use std::ops::RangeInclusive;

use egui::{DragValue, Event, Id, Key, Response, Ui};

use crate::plural::one_or_many;
use crate::studio::widgets::controls::name_widget;
use crate::studio::widgets::format::format_significant;
use crate::studio::widgets::number::{Rejection, parse};

/// Characters of a refused text that are repeated in the sentence.
const REPEATED: usize = 24;
/// Bounds beyond this size are no bounds for people.
const BOUNDLESS: f64 = 1e30;

/// A numeric field.
pub struct NumberField<'a> {
    name: &'a str,
    range: RangeInclusive<f64>,
    speed: f64,
    decimals: usize,
    prefix: &'a str,
    unit: Unit<'a>,
    is_whole: bool,
    expected: Option<String>,
    format: Option<fn(f64) -> String>,
}

/// What stands behind the number.
enum Unit<'a> {
    Symbol(&'a str),
    /// What is counted: the singular and the plural.
    Counted(&'a str, &'a str),
}

/// What a field was changed to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edit {
    /// The new value.
    pub value: f64,
    /// Whether it was typed: a commit is a step of undo of its own.
    pub is_typed: bool,
}

impl<'a> NumberField<'a> {
    /// A field called `name` for numbers in `range`, bounds included.
    pub fn new(name: &'a str, range: RangeInclusive<f64>) -> Self {
        Self {
            name,
            range,
            speed: 1.0,
            decimals: 6,
            prefix: "",
            unit: Unit::Symbol(""),
            is_whole: false,
            expected: None,
            format: None,
        }
    }

    /// A field for whole numbers in `range`, bounds included.
    pub fn whole(name: &'a str, range: RangeInclusive<usize>) -> Self {
        let range = *range.start() as f64..=*range.end() as f64;
        Self { is_whole: true, decimals: 0, speed: 0.25, ..Self::new(name, range) }
    }

    /// A field for the seed of random numbers: those that a fraction holds exactly.
    pub fn seed(name: &'a str) -> Self {
        Self::whole(name, 0..=9_000_000_000_000_000).speed(0.1)
    }

    /// By how much a point of a drag changes the value.
    pub fn speed(self, speed: f64) -> Self {
        Self { speed, ..self }
    }

    /// Most decimals that are shown.
    pub fn decimals(self, decimals: usize) -> Self {
        Self { decimals, ..self }
    }

    /// What stands before the number.
    pub fn prefix(self, prefix: &'a str) -> Self {
        Self { prefix, ..self }
    }

    /// The symbol behind the number, with the blank between them.
    pub fn unit(self, symbol: &'a str) -> Self {
        Self { unit: Unit::Symbol(symbol), ..self }
    }

    /// What the number counts, in the singular and in the plural, each with the blank before it.
    pub fn counting(self, one: &'a str, many: &'a str) -> Self {
        Self { unit: Unit::Counted(one, many), ..self }
    }

    /// What is expected of a number, in place of the range: "a number below 5".
    pub fn expecting(self, expected: String) -> Self {
        Self { expected: Some(expected), ..self }
    }

    /// How the number is shown.
    pub fn shown_as(self, format: fn(f64) -> String) -> Self {
        Self { format: Some(format), ..self }
    }

    /// Shows the field with this value; returns the new one where it was changed. Until it is, a value keeps decimals that
    /// are not shown.
    pub fn show(&self, ui: &mut Ui, value: f64) -> (Response, Option<Edit>) {
        let (mut edited, typed, refused) = (value, Cell::new(None), Cell::new(None));
        let (formatter, shown) = (ui.style().number_formatter.clone(), RefCell::new(String::new()));
        let (unit, units) = match &self.unit {
            Unit::Symbol(symbol) => (*symbol, vec![*symbol]),
            Unit::Counted(one, many) => (one_or_many((value == 1.0).into(), one, many), vec![*one, *many]),
        };
        let is_cancelled = is_cancelled(ui.ctx());
        let read = |text: &str| {
            let shown = shown.borrow();
            if is_cancelled {
                return None;
            }
            match self.read(text, &units) {
                // A field that is left without a change commits what it shows, which may lack decimals.
                Ok(number) if parse(&shown, "", &[]) == Ok(number) => None,
                Ok(number) => {
                    typed.set(Some(number));
                    Some(number)
                }
                Err(refusal) => {
                    refused.set(Some(self.sentence(text, refusal, &format!("{}{shown}{unit}", self.prefix))));
                    None
                }
            }
        };
        let field = DragValue::new(&mut edited)
            .range(self.range.clone())
            .clamp_existing_to_range(false)
            .update_while_editing(false)
            .speed(self.speed)
            .max_decimals(self.decimals)
            .prefix(self.prefix)
            .suffix(unit)
            .custom_parser(read)
            .custom_formatter(|value, decimals| {
                let text = self.format.map_or_else(|| formatter.format(value, decimals), |format| format(value));
                shown.borrow_mut().clone_from(&text);
                text
            });
        let response = ui.add(field);
        name_widget(&response, self.name);
        if let Some(sentence) = refused.take() {
            tell(ui.ctx(), sentence);
        }
        // Arrow keys and assistive technology may lead out of the range.
        let (least, most) = (*self.range.start(), *self.range.end());
        let edited = if self.is_whole { edited.round() } else { edited };
        let changed = response.changed() && edited != value && edited.is_finite();
        let edit = changed.then(|| Edit { value: edited.clamp(least, most), is_typed: typed.get().is_some() });
        (response, edit.filter(|edit| edit.value != value))
    }

    /// Shows the field with a value that is changed in place.
    pub fn edit(&self, ui: &mut Ui, value: &mut f64) -> Response {
        let (response, edit) = self.show(ui, *value);
        if let Some(edit) = edit {
            *value = edit.value;
        }
        response
    }

    /// Shows the field with a whole number that is changed in place.
    pub fn edit_whole(&self, ui: &mut Ui, value: &mut usize) -> Response {
        let (response, edit) = self.show(ui, *value as f64);
        if let Some(edit) = edit {
            *value = edit.value as usize;
        }
        response
    }

    /// The number that a text is in this field.
    fn read(&self, text: &str, units: &[&str]) -> Result<f64, Rejection> {
        let number = parse(text, self.prefix, units)?;
        if self.is_whole && number.fract() != 0.0 {
            return Err(Rejection::NotWhole);
        }
        if self.range.contains(&number) { Ok(number) } else { Err(Rejection::Outside) }
    }

    /// Why a text was refused, and which value stays.
    fn sentence(&self, text: &str, refusal: Rejection, old: &str) -> String {
        let text = text.trim();
        let typed = match text.char_indices().nth(REPEATED) {
            Some((end, _)) => format!("\"{}...\"", &text[..end]),
            None => format!("\"{text}\""),
        };
        let reason = match refusal {
            Rejection::Empty => "no number was typed".to_owned(),
            Rejection::Ambiguous => {
                let [decimal, thousands] = [".", ""].map(|separator| text.replacen(',', separator, 1));
                format!("{typed} may mean {decimal} or {thousands}")
            }
            Rejection::NoNumber => format!("{typed} is not a number"),
            Rejection::NotWhole => format!("{typed} is not a whole number"),
            Rejection::Outside => format!("{typed} is not {}", self.expected.clone().unwrap_or_else(|| self.bounds())),
        };
        format!("{}: {reason}; {old} stays", self.name)
    }

    /// The range for people.
    fn bounds(&self) -> String {
        let text = |bound: f64| if self.is_whole { format!("{bound}") } else { plain(bound) };
        match (*self.range.start(), *self.range.end()) {
            (least, most) if most >= BOUNDLESS => format!("at least {}", text(least)),
            (least, most) if least <= -BOUNDLESS => format!("at most {}", text(most)),
            (least, most) => format!("between {} and {}", text(least), text(most)),
        }
    }
}

/// A bound without digits that say nothing.
fn plain(bound: f64) -> String {
    let short = format!("{bound}");
    if short.len() <= 8 { short } else { format_significant(bound) }
}

/// Where the sentences of this frame wait.
fn place() -> Id {
    Id::unique("refused numbers")
}

/// Keeps a sentence until it is asked for. A field loses the keyboard in two passes, and is read in either.
fn tell(ctx: &egui::Context, sentence: String) {
    let (now, last) = (ctx.cumulative_pass_nr(), Id::unique("last refused number"));
    ctx.data_mut(|data| {
        let told = data.get_temp::<(u64, String)>(last);
        if told.is_none_or(|(pass, told)| told != sentence || pass + 1 < now) {
            data.get_temp_mut_or_default::<Vec<String>>(place()).push(sentence.clone());
        }
        data.insert_temp(last, (now, sentence));
    });
    ctx.request_repaint();
}

/// Whether Escape has just taken the keyboard from a field. That a field lost it is seen in the next pass too, in which
/// egui takes its text for committed.
fn is_cancelled(ctx: &egui::Context) -> bool {
    // Raw, since a shortcut may have taken the key already.
    let is_pressed = ctx.input(|input| {
        let is_escape = |event: &Event| matches!(event, Event::Key { key: Key::Escape, pressed: true, .. });
        input.raw.events.iter().any(is_escape)
    });
    let (now, place) = (ctx.cumulative_pass_nr(), Id::unique("pass of Escape"));
    ctx.data_mut(|data| {
        if is_pressed {
            data.insert_temp(place, now);
        }
        data.get_temp::<u64>(place).is_some_and(|pass| now <= pass + 1)
    })
}

/// The sentences about what number fields have refused since the last call.
pub fn take_rejections(ctx: &egui::Context) -> Vec<String> {
    ctx.data_mut(|data| data.remove_temp(place())).unwrap_or_default()
}
