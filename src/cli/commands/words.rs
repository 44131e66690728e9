//! Settings in the words of the program: flags. The library names settings
//! ([`isospan::setting`]); what the program writes to a terminal passes here.

use isospan::setting::{Setting, worded};
use std::borrow::Cow;

/// A text with its settings as flags: `--memory 4GiB`.
pub(crate) fn in_flags(text: &str) -> Cow<'_, str> {
    if text.contains('`') { Cow::Owned(worded(text, flag)) } else { Cow::Borrowed(text) }
}

fn flag(setting: Setting, value: Option<&str>) -> String {
    let name = match setting {
        Setting::Interpolation => "interp".into(),
        Setting::LabelSurface => "labels".into(),
        Setting::Measure => "no-measure".into(),
        Setting::Replace => "force".into(),
        Setting::ReplaceSteps => "replace".into(),
        other => other.name().replace('_', "-"),
    };
    match value {
        None | Some("true" | "false") => format!("--{name}"),
        Some(value) => format!("--{name} {value}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::Cli;
    use clap::CommandFactory;

    #[test]
    fn each_setting_is_a_flag() {
        let cli = Cli::command();
        let flags: Vec<&str> =
            cli.get_subcommands().flat_map(|c| c.get_arguments().filter_map(|a| a.get_long())).collect();
        for setting in Setting::ALL {
            let text = in_flags(&setting.to_string()).into_owned();
            assert!(flags.contains(&text.trim_start_matches("--")), "{text}");
        }
    }

    #[test]
    fn values_follow_their_flags() {
        let text = "give `dims=X,Y,Z`, `measure=false` or `replace=true`, not `interpolation`";
        assert_eq!(in_flags(text), "give --dims X,Y,Z, --no-measure or --force, not --interp");
    }
}
